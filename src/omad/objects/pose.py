"""Where an articulated object is in camera space."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from torch import Tensor

from omad.common.arrays import as_numpy
from omad.geometry.kinematics import KinematicTree, joint_lines, part_transforms
from omad.geometry.rigid import mirrored
from omad.geometry.transforms import MIRROR_X


@dataclass(frozen=True, eq=False)
class ObjectPose:
    """An articulated object in camera space, estimated or true; or several, with an axis for them before all others."""

    states: np.ndarray
    """(J,)."""
    axes: np.ndarray
    """(J, 3) unit, camera frame."""
    pivots: np.ndarray
    """(J, 3) a point of each axis, camera frame."""
    T_camera_part: np.ndarray
    """(K, 4, 4) canonical rest coordinates to camera."""

    @classmethod
    def at(cls, tree: KinematicTree, axes: Tensor, pivots: Tensor, states: Tensor, T_camera_base: Tensor) -> Self:
        """B objects with canonical axes and pivots (B, J, 3), states (B, J) and base poses (B, 4, 4), in metres. Worked
        out in the dtype of the tensors, which may be on any device; float64 comes out."""
        G = part_transforms(tree, axes, pivots, states, T_camera_base)
        lines = joint_lines(tree, axes, pivots, G)
        return cls(*(np.array(as_numpy(t), dtype=np.float64) for t in (states, lines.axes, lines.pivots, G)))

    @classmethod
    def stack(cls, poses: Sequence[Self]) -> Self:
        """Several in one."""
        return cls(*(np.stack([getattr(pose, field.name) for pose in poses]) for field in fields(cls)))

    def rows(self) -> list[Self]:
        """Each of several."""
        return [type(self)(*row) for row in zip(*(getattr(self, field.name) for field in fields(self)), strict=True)]

    def swapped(self) -> Self:
        """The same object with its two parts' names exchanged, turned half about z (``Category.swap_symmetry``)."""
        return replace(self, axes=-self.axes, T_camera_part=self.T_camera_part[::-1] @ np.diag([-1.0, -1.0, 1.0, 1.0]))

    def mirrored(self, turning: Sequence[bool]) -> Self:
        """Its image in the camera's plane x = 0: of the object that is the mirror image, in x = 0 of canonical space.
        States keep their signs: the images of axes that things turn about (``turning``, (J,)) are turned round."""
        axes = mirrored_axes(self.axes, turning)
        return replace(self, axes=axes, pivots=self.pivots * MIRROR_X, T_camera_part=mirrored(self.T_camera_part))


def mirrored_axes(axes: np.ndarray, turning: Sequence[bool]) -> np.ndarray:
    """Images in the plane x = 0 of axes (J, 3), about which things turn (``turning``) or along which they slide."""
    return axes * MIRROR_X * np.where(turning, -1.0, 1.0)[:, None]
