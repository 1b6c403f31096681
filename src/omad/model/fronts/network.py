"""A network that tells the categories by their fronts: an image of one -> how likely it is of each of them.

It sees what the look that proposes categories cannot: gaps, handles, how many drawers there are.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from scipy.special import logsumexp
from torch import Tensor, nn
from torch.nn.functional import adaptive_avg_pool1d

from omad.common.decode import decode
from omad.common.runtime import undisturbed

from ..checkpoint import Network, load
from .image import CHANNELS

WEIGHTS = Path(__file__).parent / "weights"
FEATURES = 48
"""Of a place of the image, and of its rows where they are counted."""
HEIGHTS = 4
"""Parts of the front, from its foot to its top, of which each has its say."""


class FrontNet(Network):
    """Logits of the categories ``names``."""

    kind = "fronts"

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        self.names = tuple(names)
        steps = (CHANNELS, 16, 1), (16, 24, 2), (24, 32, (1, 2)), (32, 32, 2), (32, FEATURES, 1)
        self.places = nn.Sequential(*(layer(nn.Conv2d(a, b, 3, step, 1, bias=False)) for a, b, step in steps))
        widths = (2 * FEATURES, FEATURES), (FEATURES, FEATURES)
        self.rows = nn.Sequential(*(layer(nn.Conv1d(a, b, 5, padding=2, bias=False)) for a, b in widths))
        self.head = nn.Sequential(
            nn.Linear((2 + HEIGHTS) * FEATURES, FEATURES), nn.ReLU(), nn.Dropout(0.2), nn.Linear(FEATURES, len(names))
        )

    def described(self) -> dict[str, Any]:
        return {"names": self.names}

    @classmethod
    def from_description(cls, config: dict[str, Any]) -> Self:
        return cls(decode(tuple[str, ...], config["names"]))

    def forward(self, images: Tensor) -> Tensor:
        """images (B, 5, ROWS, COLUMNS), as of ``front_image`` -> logits (B, C)."""
        places = self.places(images)
        rows = self.rows(torch.cat([places.mean(3), places.amax(3)], 1))
        each = adaptive_avg_pool1d(rows, HEIGHTS).flatten(1)
        return self.head(torch.cat([rows.mean(2), rows.amax(2), each], 1))

    @undisturbed()
    def says(self, images: np.ndarray) -> np.ndarray:
        """Logarithm of the probability of each category (B, C), by images (B, 5, ROWS, COLUMNS)."""
        return self(torch.from_numpy(images).to(next(self.parameters()))).log_softmax(1).double().cpu().numpy()

    def odds(self, images: np.ndarray, name: str) -> np.ndarray:
        """(B,) log-odds of the category ``name`` over all others, by such images; zeros where it is not known."""
        if name not in self.names:
            return np.zeros(len(images))
        logs, own = self.says(images), self.names.index(name)
        return logs[:, own] - logsumexp(np.delete(logs, own, 1), axis=1)


def layer(convolution: nn.Conv1d | nn.Conv2d) -> nn.Sequential:
    """A convolution, normalised and rectified."""
    norm = nn.BatchNorm2d if isinstance(convolution, nn.Conv2d) else nn.BatchNorm1d
    return nn.Sequential(convolution, norm(convolution.out_channels), nn.ReLU())


@cache
def shipped_front_net() -> FrontNet:
    """The one in the package."""
    return load(FrontNet, WEIGHTS)
