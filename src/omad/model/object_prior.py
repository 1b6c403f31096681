"""Where an object's keypoints truly are: what OMAD-PriorNet finds on the complete object."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from omad.common.arrays import as_doubles
from omad.data.surface_bank import SurfaceBank
from omad.objects.model import ObjectModel, SampledObject

from .priornet import PriorNet

HALF_TURN_Z = np.array([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class ObjectPrior:
    """What the prior says of N complete objects; canonical space, metres."""

    keypoints: np.ndarray
    """(N, M, 3) that the basis makes."""
    axes: np.ndarray
    """(N, J, 3) unit, of the joint function."""
    pivots: np.ndarray
    """(N, J, 3), NaN where the axis has no place."""
    beta: np.ndarray
    """(N, D)."""


@torch.no_grad()
def object_prior(net: PriorNet, models: Sequence[SampledObject]) -> ObjectPrior:
    """Fit the prior to complete objects."""
    unit = net.category.metres_per_unit
    bank = SurfaceBank.from_models(models, net.category).to(net.part_of.device)
    beta = net.prior.encode(object_keypoints(net, bank))
    joints, keypoints = net.prior.joints(beta), as_doubles(net.prior.keypoints(beta)) * unit
    pivots = np.where(np.array(net.category.turning)[:, None], as_doubles(joints.pivots) * unit, np.nan)
    return ObjectPrior(keypoints, as_doubles(joints.axes), pivots, as_doubles(beta))


def relabelled(model: ObjectModel) -> ObjectModel:
    """An object of two alike parts turned half about z with its parts exchanged (``Category.swap_symmetry``)."""
    parts = tuple(part.warped(lambda vertices: vertices * HALF_TURN_Z) for part in reversed(model.parts))
    return replace(model, parts=parts, pivots=model.pivots * HALF_TURN_Z)


@torch.no_grad()
def object_keypoints(net: PriorNet, bank: SurfaceBank) -> Tensor:
    """Nodes (N, M, 3) of every object at its own scale, from all of its samples: what OMADNet learns to find."""
    parts, nodes = range(len(net.category.parts)), []
    for points, labels in zip(bank.points, bank.labels, strict=True):
        nodes.append(net([points[labels == part][None] for part in parts]).nodes)
    return torch.cat(nodes)
