"""PointNet++ (Qi et al. 2017) in plain PyTorch, channels last.

Points come in random order, so the first n of them are a random subset: they serve as centres
without a sampling step, the same on every device. Groups are the k nearest neighbours of a
centre, optionally within a radius as in the paper's ball query.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .interface import Backbone, BackboneConfig, Features


def gather(values: Tensor, index: Tensor) -> Tensor:
    """Rows of ``values`` (B, N, C) at ``index`` (B, ...) -> (B, ..., C)."""
    flat = index.flatten(1)[..., None].expand(-1, -1, values.shape[-1])
    return values.gather(1, flat).reshape(*index.shape, values.shape[-1])


def nearest(queries: Tensor, points: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Squared distances and indices (B, Q, k) of the k nearest ``points`` (B, N, 3) to ``queries`` (B, Q, 3)."""
    distance = queries.square().sum(-1, keepdim=True) - 2 * queries @ points.mT + points.square().sum(-1)[:, None]
    squared, index = distance.topk(k, largest=False, sorted=False)
    return squared.clamp(min=0), index


class Residual(nn.Module):
    """Pre-norm pointwise residual MLP."""

    def __init__(self, width: int) -> None:
        super().__init__()
        wide = 2 * width
        self.layers = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, wide), nn.ReLU(), nn.Linear(wide, width))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.layers(x)


class SetAbstraction(nn.Module):
    """Group the neighbours of each centre, a shared two-layer MLP, max over the group."""

    def __init__(self, features: int, width: int, neighbours: int, scale: float, radius: float | None = None) -> None:
        super().__init__()
        self.neighbours, self.scale, self.radius = neighbours, scale, radius
        # the first layer acts on the points before they are copied into groups: cheaper, and the same sum
        self.point_layer = nn.Linear(3 + features, width)
        self.centre_layer = nn.Linear(3, width, bias=False)
        self.group_layer = nn.Linear(width, width)
        self.residual = Residual(width)

    def forward(self, points: Tensor, features: Tensor | None, centres: int) -> Tensor:
        """points (B, N, 3), features (B, N, C) -> (B, centres, width) at the first ``centres`` points."""
        centre = points[:, :centres]
        with torch.no_grad():
            squared, index = nearest(centre, points, self.neighbours)
            if self.radius is not None:
                own = torch.arange(centres, device=points.device)[None, :, None]
                index = torch.where(squared < self.radius**2, index, own)
        joint = points / self.scale if features is None else torch.cat([points / self.scale, features], -1)
        grouped = gather(self.point_layer(joint), index) - self.centre_layer(centre / self.scale)[:, :, None]
        grouped = self.group_layer(grouped.relu()).amax(2)
        return self.residual(grouped)


class Fuse(nn.Module):
    """Coarse features, carried to the fine points, joined with theirs."""

    def __init__(self, coarse: int, fine: int, width: int) -> None:
        super().__init__()
        self.coarse_layer = nn.Linear(coarse, width)
        self.fine_layer = nn.Linear(fine, width, bias=False)
        self.residual = Residual(width)

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        """(B, N or 1, coarse), (B, N, fine) -> (B, N, width)."""
        return self.residual((self.coarse_layer(coarse) + self.fine_layer(fine)).relu())


def interpolate(queries: Tensor, points: Tensor, values: Tensor) -> Tensor:
    """Values (B, n, C) at ``points`` carried to ``queries`` (B, N, 3) by inverse squared distance -> (B, N, C)."""
    with torch.no_grad():
        squared, index = nearest(queries, points, 3)
        weight = 1 / (squared + 1e-6)
        weight = weight / weight.sum(-1, keepdim=True)
    return (gather(values, index) * weight[..., None]).sum(2)


@dataclass(frozen=True)
class PointNet2Config(BackboneConfig):
    """Sizes of PointNet++. The defaults are the slim net."""

    kind = "pointnet2"

    centres: tuple[int, int] = (128, 32)
    neighbours: tuple[int, int] = (16, 16)
    widths: tuple[int, int, int] = (96, 160, 256)
    """Features after the first and second set abstraction, and global."""
    radii: tuple[float | None, float | None] = (None, None)
    """Ball-query radii in category units; None: plain nearest neighbours."""

    @property
    def pooled(self) -> int:
        return self.widths[2]

    def build(self) -> PointNet2:
        return PointNet2(self)


class PointNet2(Backbone):
    """Two set abstractions, a global feature, and features propagated back to the first centres."""

    def __init__(self, config: PointNet2Config) -> None:
        super().__init__()
        self.config: PointNet2Config = config
        first, second, pooled = config.widths
        self.abstraction1 = SetAbstraction(0, first, config.neighbours[0], scale=0.2, radius=config.radii[0])
        self.abstraction2 = SetAbstraction(first, second, config.neighbours[1], scale=0.4, radius=config.radii[1])
        self.global_layers = nn.Sequential(nn.Linear(second + 3, pooled), nn.ReLU(), nn.Linear(pooled, pooled))
        self.global_residual = Residual(pooled)
        self.fuse2 = Fuse(pooled, second, second)
        self.fuse1 = Fuse(second, first, config.dense)
        self.dense_residual = Residual(config.dense)

    def forward(self, points: Tensor) -> Features:
        """points (B, N, 3) in random order, category units, centred near the origin."""
        n1, n2 = self.config.centres
        points1, points2 = points[:, :n1], points[:, :n2]
        features1 = self.abstraction1(points, None, n1)
        features2 = self.abstraction2(points1, features1, n2)
        pooled = self.global_residual(self.global_layers(torch.cat([features2, points2], -1)).amax(1))
        features2 = self.fuse2(pooled[:, None], features2)
        dense = self.fuse1(interpolate(points1, points2, features2), features1)
        return Features(centres=points1, dense=self.dense_residual(dense), pooled=pooled)
