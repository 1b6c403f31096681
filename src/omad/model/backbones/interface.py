"""What networks ask of a backbone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor, nn


@dataclass(frozen=True)
class Features:
    """What a backbone says of B clouds."""

    centres: Tensor
    """(B, C, 3) the points that carry dense features."""
    dense: Tensor
    """(B, C, dense)."""
    pooled: Tensor
    """(B, pooled)."""


class Backbone(nn.Module):
    """Turns points (B, N, 3), in random order, in category units and centred near the origin, into ``Features``."""

    config: BackboneConfig

    def pooled(self, points: Tensor) -> Tensor:
        """(B, pooled) alone, where that is less work."""
        return self(points).pooled


@dataclass(frozen=True)
class BackboneConfig:
    """Sizes of a backbone, plain numbers and tuples of them. A backbone derives its own from it."""

    kind: ClassVar[str]
    """What checkpoints call the backbone."""

    points: int = 512
    """Points of the input cloud."""
    dense: int = 128
    """Features of each centre that votes."""

    @property
    def pooled(self) -> int:
        """Features of the whole cloud."""
        raise NotImplementedError

    def takes_weights_of(self, other: BackboneConfig) -> bool:
        """Whether the weights of a backbone of these sizes and of the ``other`` are alike in shape and meaning."""
        return self == other

    def build(self) -> Backbone:
        """A fresh backbone of these sizes."""
        raise NotImplementedError
