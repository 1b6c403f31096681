"""PointNet++ (Qi et al. 2017), channels last.

Points come in random order, so the first n of them are a random subset: they serve as centres
without a sampling step, the same on every device. Groups are the k nearest neighbours of a
centre, optionally within a radius as in the paper's ball query.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor, nn

from omad.common.decode import within
from omad.common.limits import check_limit

from .interface import Backbone, BackboneConfig, Features
from .point_ops import interpolate, nearest, pooled_groups


def identity(features: Tensor) -> Tensor:
    """The same."""
    return features


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
        squared, index = nearest(centre, points, self.neighbours)
        if self.radius is not None:
            own = torch.arange(centres, dtype=index.dtype, device=points.device)[None, :, None]
            index = torch.where(squared < self.radius**2, index, own)
        joint = points / self.scale if features is None else torch.cat([points / self.scale, features], -1)
        values, offsets = self.point_layer(joint), self.centre_layer(centre / self.scale)
        grouped = pooled_groups(values, offsets, index, self.group_layer.weight, self.group_layer.bias)
        return self.residual(grouped)


class Fuse(nn.Module):
    """Coarse features joined with those of the fine points."""

    def __init__(self, coarse: int, fine: int, width: int) -> None:
        super().__init__()
        self.coarse_layer = nn.Linear(coarse, width)
        self.fine_layer = nn.Linear(fine, width, bias=False)
        self.residual = Residual(width)

    def forward(self, coarse: Tensor, fine: Tensor, carry: Callable[[Tensor], Tensor] = identity) -> Tensor:
        """(B, n, coarse), (B, N, fine) -> (B, N, width). ``carry`` brings features of n coarse points to N fine ones;
        linear as it is, it may follow the layer, which has less to do before. Without it n is N or 1."""
        return self.residual((carry(self.coarse_layer(coarse)) + self.fine_layer(fine)).relu())


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

    def __post_init__(self) -> None:
        sizes = {"points": (self.points,), "dense": (self.dense,), "centres": self.centres, "widths": self.widths}
        for name, numbers in (sizes | {"neighbours": self.neighbours}).items():
            with within(f"{name}: "):
                check_limit("points", max(numbers), "the network")
            if min(numbers) < 1:
                raise ValueError(f"{name}: is {numbers}; give whole numbers from 1")
        for name, chosen in (("centres", self.centres), ("neighbours", self.neighbours)):
            if chosen[0] > self.points or chosen[1] > self.centres[0]:
                raise ValueError(f"{name}: are more than the points that they are chosen of")
        if any(radius is not None and not 0 < radius < 1e4 for radius in self.radii):
            raise ValueError(f"radii: are {self.radii}; give lengths above 0, or none")

    @property
    def pooled(self) -> int:
        return self.widths[2]

    def takes_weights_of(self, other: BackboneConfig) -> bool:
        """Also of one that looks at more or fewer points."""
        if not isinstance(other, PointNet2Config):
            return False
        return (self.dense, self.widths) == (other.dense, other.widths)

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
        features1, features2, pooled = self._abstracted(points)
        features2 = self.fuse2(pooled[:, None], features2)
        dense = self.fuse1(features2, features1, partial(interpolate, points1, points2))
        return Features(centres=points1, dense=self.dense_residual(dense), pooled=pooled)

    def pooled(self, points: Tensor) -> Tensor:
        return self._abstracted(points)[2]

    def _abstracted(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features of the first and of the second centres, and of the whole."""
        n1, n2 = self.config.centres
        features1 = self.abstraction1(points, None, n1)
        features2 = self.abstraction2(points[:, :n1], features1, n2)
        pooled = self.global_residual(self.global_layers(torch.cat([features2, points[:, :n2]], -1)).amax(1))
        return features1, features2, pooled
