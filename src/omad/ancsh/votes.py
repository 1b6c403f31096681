"""Joints in NAOCS: every point near a joint says where its axis is, and how it points."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..categories import Category
from .coordinates import HEAT_RADIUS, linked
from .net import AncshPrediction

ROUNDS = 5
"""Of Weiszfeld's iteration."""


@dataclass(frozen=True)
class VotedJoints:
    """J joints of B objects in NAOCS; of no meaning where no point is of a part that the joint links."""

    axes: Tensor
    """(B, J, 3) unit."""
    pivots: Tensor
    """(B, J, 3)."""


def vote_joints(said: AncshPrediction, labels: Tensor, naocs: Tensor, category: Category) -> VotedJoints:
    """Median of what points say of each joint. labels (B, N), naocs (B, N, 3).

    A revolute joint is told by the points of the two parts it links, by their heat (squared: where no point is near the
    axis the nearest still decide); a prismatic one by all points of its parts.
    """
    revolute = torch.tensor(category.revolute, device=naocs.device)
    weights = linked(labels, category) * torch.where(revolute, said.heat.square(), 1.0)
    places = naocs[:, :, None] + said.towards * ((1 - said.heat) * HEAT_RADIUS)[..., None]
    axes = torch.nn.functional.normalize(_median(said.axes, weights), dim=-1)
    return VotedJoints(axes=axes, pivots=_median(places, weights) * revolute[:, None])


def _median(values: Tensor, weights: Tensor) -> Tensor:
    """Weighted geometric median (B, J, 3) of values (B, N, J, 3) with weights (B, N, J)."""
    pull = weights
    for _ in range(ROUNDS):
        middle = (pull[..., None] * values).sum(1) / pull.sum(1).clamp(min=1e-12)[..., None]
        pull = weights / (values - middle[:, None]).norm(dim=-1).clamp(min=1e-3)
    return (pull[..., None] * values).sum(1) / pull.sum(1).clamp(min=1e-12)[..., None]
