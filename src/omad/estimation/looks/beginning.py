"""Where the first look at observations begins."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from omad.geometry.rigid import mirrored
from omad.objects.category import Category

from ..known import Near
from ..several_views import Rig


@dataclass(frozen=True, eq=False)
class Beginning:
    """In frames with the cameras' axes, unless one of ``near``, ``rig`` and ``frames`` is given."""

    near: Near | None = None
    """The one observation is of an object that was seen before."""
    rig: Rig | None = None
    """Of the cameras of all observations: these are views of one object at one moment."""
    frames: np.ndarray | None = None
    """(B, 4, 4) T_camera_base, metres: the observations' objects may stand so."""
    choice: int = 0
    """Which random choices of the points are shown: what is added to the estimator's seed."""

    @property
    def is_anywhere(self) -> bool:
        """Whether none of them is."""
        return self.near is None and self.rig is None and self.frames is None

    def T_camera_base(self, category: Category, like: Tensor) -> Tensor | None:
        """(B, 4, 4), category units, to take the first look in; None: in the camera's axes. Dtype and device are those
        of ``like``."""
        if self.near is not None:
            return self.near.start(category, like).T_camera_base
        if self.frames is None:
            return None
        frames = self.frames.copy()
        frames[:, :3, 3] /= category.metres_per_unit
        return torch.as_tensor(frames, dtype=like.dtype, device=like.device)

    def mirrored(self) -> Beginning:
        """Of what is seen in a mirror in the camera's plane x = 0."""
        near = None if self.near is None else self.near.mirrored()
        rig = None if self.rig is None else self.rig.mirrored()
        return replace(self, near=near, rig=rig, frames=None if self.frames is None else mirrored(self.frames))


ANYWHERE = Beginning()
