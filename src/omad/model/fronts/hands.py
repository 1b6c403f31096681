"""A network that tells an object from its mirror image by its front: where on a door its handle is, and what is beside.

It is told nothing that it could not see: an image and its mirror image get opposite answers by construction.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import adaptive_avg_pool2d

from omad.common.decode import decode
from omad.common.runtime import undisturbed

from ..checkpoint import Network, load
from .image import CHANNELS
from .network import layer

WEIGHTS = Path(__file__).parent / "hand_weights"
FEATURES = 32
PLACES = 5, 6
"""Rows and columns of the front, each of which has its say."""


class HandNet(Network):
    """Log-odds that an object of each of the categories ``names`` is of the category's own hand."""

    kind = "hands"

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        self.names = tuple(names)
        steps = (CHANNELS, 16, 1), (16, 24, 2), (24, FEATURES, 2), (FEATURES, FEATURES, 2), (FEATURES, FEATURES, 1)
        self.places = nn.Sequential(*(layer(nn.Conv2d(a, b, 3, step, 1, bias=False)) for a, b, step in steps))
        self.head = nn.Sequential(
            nn.Dropout(0.2), nn.Linear(PLACES[0] * PLACES[1] * FEATURES, FEATURES), nn.ReLU(),
            nn.Linear(FEATURES, len(names)),
        )  # fmt: skip

    def described(self) -> dict[str, Any]:
        return {"names": self.names}

    @classmethod
    def from_description(cls, config: dict[str, Any]) -> Self:
        return cls(decode(tuple[str, ...], config["names"]))

    def forward(self, images: Tensor) -> Tensor:
        """images (B, 5, ROWS, COLUMNS), as of ``front_image`` -> log-odds (B, C)."""
        one, other = self._side(torch.cat([images, images.flip(3)])).chunk(2)
        return one - other

    def _side(self, images: Tensor) -> Tensor:
        return self.head(adaptive_avg_pool2d(self.places(images), PLACES).flatten(1))

    @undisturbed()
    def says(self, image: np.ndarray, name: str) -> float:
        """Log-odds for one image (5, ROWS, COLUMNS) of a category; 0 for one that it does not know."""
        if name not in self.names:
            return 0.0
        shown = torch.from_numpy(image)[None].to(next(self.parameters()))
        return float(self(shown)[0, self.names.index(name)])


@cache
def shipped_hand_net() -> HandNet:
    """The one in the package."""
    return load(HandNet, WEIGHTS)
