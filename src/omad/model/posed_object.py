"""Objects as a prior describes them, where they are: NumPy, metres, radians."""

from dataclasses import dataclass

import numpy as np
import torch

from omad.common.arrays import as_doubles
from omad.objects.category import Category
from omad.objects.pose import ObjectPose

from .fitting.state import State
from .prior import OmadPrior


@dataclass(frozen=True)
class PosedObject:
    """One object of a category: shape, and place in camera space."""

    beta: np.ndarray
    """(D,)."""
    placed: ObjectPose
    canonical_keypoints: np.ndarray
    """(M, 3) at rest."""
    canonical_axes: np.ndarray
    """(J, 3)."""
    canonical_pivots: np.ndarray
    """(J, 3)."""
    keypoints: np.ndarray
    """(M, 3) camera frame."""


@torch.no_grad()
def posed_objects(prior: OmadPrior, category: Category, state: State) -> list[PosedObject]:
    """The B objects of a ``state`` in category units."""
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
