"""What the coordinates of a written file refer to."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from omad.geometry.rigid import rigid_transform
from omad.objects import category


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame in which an observed object can be written down."""

    name: str
    """As robots' programs know it."""
    T_frame_camera: np.ndarray
    """(4, 4)."""
    upright: bool = False
    """Whether its z points up."""

    @classmethod
    def of(cls, T_world_camera: Any | None) -> Self:
        """The world, z up, where the camera's pose (4, 4) in it is known; the camera otherwise. Raises InputError for
        what is no pose."""
        if T_world_camera is None:
            return cls(category.CAMERA, np.eye(4))
        return cls(category.WORLD, rigid_transform(T_world_camera, "T_world_camera"), upright=True)


CAMERA = Frame.of(None)
"""OpenCV: x right, y down, z forward."""
