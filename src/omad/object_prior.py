"""Where an object's keypoints truly are: what OMAD-PriorNet finds on the complete object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from .objects import Mesh, ObjectModel, SampledObject
from .priornet import PriorNet
from .train_prior import object_keypoints
from .views import SurfaceBank

HALF_TURN_Z = np.array([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class ObjectPrior:
    """What the prior says of N complete objects; canonical space, metres."""

    keypoints: np.ndarray
    """(N, M, 3) that the basis makes."""
    axes: np.ndarray
    """(N, J, 3) unit, of the joint function."""
    pivots: np.ndarray
    """(N, J, 3), NaN for prismatic joints."""
    beta: np.ndarray
    """(N, D)."""


@torch.no_grad()
def object_prior(net: PriorNet, models: Sequence[SampledObject]) -> ObjectPrior:
    """Fit the prior to complete objects."""
    unit = net.category.metres_per_unit
    bank = SurfaceBank.from_models(models, net.category).to(net.part_of.device)
    beta = net.prior.encode(object_keypoints(net, bank))
    joints = net.prior.joints(beta)
    pivots = joints.pivots.cpu().double().numpy() * unit
    return ObjectPrior(
        keypoints=net.prior.keypoints(beta).cpu().double().numpy() * unit,
        axes=joints.axes.cpu().double().numpy(),
        pivots=np.where(np.array(net.category.revolute)[:, None], pivots, np.nan),
        beta=beta.cpu().double().numpy(),
    )


def relabelled(model: ObjectModel) -> ObjectModel:
    """An object of two alike parts turned half about z with its parts exchanged (``Category.swap_symmetry``)."""
    parts = tuple(Mesh(part.vertices * HALF_TURN_Z, part.faces) for part in reversed(model.parts))
    return replace(model, parts=parts, pivots=model.pivots * HALF_TURN_Z)


def placed(keypoints: np.ndarray, T_camera_part: np.ndarray, part_of: Sequence[int]) -> np.ndarray:
    """Canonical keypoints (M, 3) carried by the transforms (K, 4, 4) of their parts."""
    T = T_camera_part[list(part_of)]
    return (T[:, :3, :3] @ keypoints[..., None])[..., 0] + T[:, :3, 3]
