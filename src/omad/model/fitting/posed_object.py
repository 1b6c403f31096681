"""Objects as a prior describes them, where they are: NumPy, metres, radians."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch

from omad.common.arrays import as_doubles
from omad.geometry.transforms import MIRROR_X
from omad.objects.category import Category
from omad.objects.pose import ObjectPose, mirrored_axes

from ..prior import OmadPrior
from .state import State


@dataclass(frozen=True, eq=False)
class PosedObject:
    """One object of a category: shape, and place in camera space."""

    beta: np.ndarray
    """(D,)."""
    placed: ObjectPose
    """Joint states, axes, pivots and part poses, as the metrics take them: metres, camera frame."""
    canonical_keypoints: np.ndarray
    """(M, 3) at rest."""
    canonical_axes: np.ndarray
    """(J, 3)."""
    canonical_pivots: np.ndarray
    """(J, 3)."""
    keypoints: np.ndarray
    """(M, 3) camera frame."""

    def reflected(self, turning: Sequence[bool]) -> Self:
        """Its image in the camera's plane x = 0; ``turning`` as ``Category`` has it. ``beta`` stays that of the object
        in the mirror."""
        return replace(
            self,
            placed=self.placed.mirrored(turning),
            canonical_keypoints=self.canonical_keypoints * MIRROR_X,
            canonical_axes=mirrored_axes(self.canonical_axes, turning),
            canonical_pivots=self.canonical_pivots * MIRROR_X,
            keypoints=self.keypoints * MIRROR_X,
        )


class Poser:
    """``posed_objects`` with a category's constants worked out once, and compiled on the CPU."""

    def __init__(self, prior: OmadPrior, category: Category) -> None:
        self._prior, self._category, self._compiled = prior, category, None
        if prior.learned_basis.device.type == "cpu":
            from .kernel.prior import kernel_prior  # compiled only where it is used

            self._compiled = kernel_prior(prior)

    def __call__(self, state: State) -> list[PosedObject]:
        """The B objects of a ``state`` in category units."""
        if self._compiled is None:
            return posed_objects(self._prior, self._category, state)
        from .kernel.objects import place_objects

        category, rows = self._category, as_doubles(state.pack())
        beta, *found = place_objects(self._compiled, rows, category.metres_per_unit, category.state_units)
        placed = map(ObjectPose, *found[:4])
        return list(map(PosedObject, beta, placed, *found[4:]))


@torch.no_grad()
def posed_objects(prior: OmadPrior, category: Category, state: State) -> list[PosedObject]:
    """The B objects of a ``state`` in category units; on any device."""
    unit = category.metres_per_unit
    joints = prior.joints(state.beta)
    pivots = joints.pivots * unit
    states = state.joint_states * torch.as_tensor(category.state_units).to(state.joint_states)
    T_camera_base = state.T_camera_base.clone()
    T_camera_base[:, :3, 3] *= unit
    poses = ObjectPose.at(category.metric_tree, joints.axes, pivots, states, T_camera_base)
    beta, rest, axes, pivots = map(as_doubles, (state.beta, prior.keypoints(state.beta), joints.axes, pivots))
    rest = rest * unit
    T = poses.T_camera_part[:, list(category.part_of_keypoint)]
    keypoints = (T[..., :3, :3] @ rest[..., None])[..., 0] + T[..., :3, 3]
    return [PosedObject(*row) for row in zip(beta, poses.rows(), rest, axes, pivots, keypoints, strict=True)]
