"""A-NCSH's training losses: cross-entropy for parts, distances for coordinates and joints."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..categories import Category
from .coordinates import Coordinates, linked, pick
from .net import AncshPrediction


@dataclass(frozen=True)
class AncshLossWeights:
    """The authors' weights: coordinates ten times the rest."""

    segmentation: float = 1.0
    npcs: float = 10.0
    naocs: float = 10.0
    heat: float = 1.0
    towards: float = 1.0
    axes: float = 1.0


def ancsh_losses(
    out: AncshPrediction, truth: Coordinates, category: Category, weights: AncshLossWeights
) -> dict[str, Tensor]:
    """Every weighted term of the loss; their sum is the loss.

    Coordinates count for a point's true part. A joint's axis is asked of the two parts that it links, the way to it of
    points near it.
    """
    revolute = torch.tensor(category.revolute, device=truth.heat.device)
    npcs, sizes, centres = (_own(values, truth.labels) for values in (out.npcs, out.sizes[..., None], out.centres))
    naocs = (sizes * npcs + centres - truth.naocs).norm(dim=-1)
    # a point's size and centre could make up for each other; so they are asked for, too
    size = (sizes.squeeze(-1) - pick(truth.sizes, truth.labels)).abs()
    centre = (centres - pick(truth.centres, truth.labels)).norm(dim=-1)
    near = truth.heat > 0
    return {
        "segmentation": weights.segmentation
        * torch.nn.functional.cross_entropy(out.part_logits.flatten(0, 1), truth.labels.flatten()),
        "npcs": weights.npcs * (npcs - truth.npcs).norm(dim=-1).mean(),
        "naocs": weights.naocs * (naocs.mean() + size.mean() + centre.mean()) / 3,
        "heat": weights.heat * _mean((out.heat - truth.heat).abs(), revolute.expand_as(near)),
        "towards": weights.towards * _mean((out.towards - truth.towards).norm(dim=-1), near),
        "axes": weights.axes * _mean((out.axes - truth.axes[:, None]).norm(dim=-1), linked(truth.labels, category)),
    }


def _own(values: Tensor, labels: Tensor) -> Tensor:
    """Of values per point and part (B, N, K, C) those of the point's own part, ``labels`` (B, N) -> (B, N, C)."""
    index = labels[..., None, None].expand(*labels.shape, 1, values.shape[-1])
    return values.gather(2, index).squeeze(2)


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return (values * where).sum() / where.sum().clamp(min=1)
