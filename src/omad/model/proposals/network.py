"""One network for all categories: a partial cloud -> how likely it is of each of them, or of none.

It spares the fitting of every category to every cloud: one look proposes a few, and only those are fitted. Size tells
categories apart as well as shape does (a microwave from an oven, both from a refrigerator), so it sees the cloud at one
size and that size, in metres, beside it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn

from omad.common.decode import decode
from omad.common.runtime import undisturbed
from omad.sensing.observation import Observation
from omad.sensing.point_choice import choose_points

from ..backbones import SLIM, BackboneConfig, backbone_from_dict, backbone_to_dict
from ..checkpoint import Network, load

WEIGHTS = Path(__file__).parent / "weights"
SPREAD = 0.5
"""Median distance of the shown points from their middle: about that of a category's clouds in its units."""
QUANTILES = 0.5, 0.9
"""Of the points' distances from their middle: what tells the size."""
SIZES = torch.logspace(math.log10(0.02), math.log10(1.5), 16)
"""Metres between which sizes are told apart."""
SAMPLES = 4
"""Random choices of a cloud's points that are looked at."""


class ProposalNet(Network):
    """A backbone and one head: logits of the categories ``names`` and, last, of none of them."""

    kind = "proposals"

    def __init__(self, names: Sequence[str], backbone: BackboneConfig = SLIM) -> None:
        super().__init__()
        self.names = tuple(names)
        self.backbone = backbone.build()
        width = backbone.pooled
        self.head = nn.Sequential(
            nn.Linear(width + len(QUANTILES) * len(SIZES), width), nn.ReLU(), nn.Linear(width, len(self.names) + 1)
        )

    def described(self) -> dict[str, Any]:
        return {"names": self.names, "backbone": backbone_to_dict(self.backbone.config)}

    @classmethod
    def from_description(cls, config: dict[str, Any]) -> Self:
        return cls(decode(tuple[str, ...], config["names"]), backbone_from_dict(config["backbone"]))

    def start_from(self, other: Self) -> None:
        """Take over what a network with the same backbone knows, which may tell other categories."""
        known, last = self.state_dict(), f"head.{len(self.head) - 1}."
        for name, theirs in other.state_dict().items():
            if not name.startswith(last):
                known[name] = theirs
                continue
            known[name][-1] = theirs[-1]
            for row, category in enumerate(self.names):
                if category in other.names:
                    known[name][row] = theirs[other.names.index(category)]
        self.load_state_dict(known)

    def forward(self, points: Tensor) -> Tensor:
        """points (B, N, 3) in metres, camera frame, in random order -> logits (B, C + 1)."""
        middle = points.median(1, keepdim=True).values
        spread = (points - middle).norm(dim=-1).quantile(points.new_tensor(QUANTILES), 1).T.clamp(min=1e-6)
        shown = (points - middle) * (SPREAD / spread[:, :1, None])
        return self.head(torch.cat([self.backbone.pooled(shown), _near(spread).flatten(1)], -1))


def _near(sizes: Tensor) -> Tensor:
    """How near metres (B, Q) are to each of ``SIZES``, (B, Q, 16): 1 there, a tenth two of them farther on."""
    levels = SIZES.to(sizes).log()
    steps = (sizes.clamp(SIZES[0], SIZES[-1]).log()[..., None] - levels) / (levels[1] - levels[0])
    return (-0.58 * steps.square()).exp()


@dataclass(frozen=True)
class Proposer:
    """Says which categories clouds may be of."""

    net: ProposalNet
    """Its network."""

    @undisturbed()
    def __call__(self, observations: Sequence[Observation], seed: int = 0) -> list[dict[str | None, float]]:
        """Of each observation, the probability of every category and of none (None), likeliest first."""
        if not observations:
            return []
        points = self.net.backbone.config.points
        shown = torch.stack(
            [torch.from_numpy(o.points[choose_points(o.points, points, SAMPLES, seed)]) for o in observations]
        )
        weight = next(self.net.parameters())
        logits = self.net(shown.flatten(0, 1).to(weight)).unflatten(0, (-1, SAMPLES))
        names = (*self.net.names, None)
        rows = logits.mean(1).softmax(-1).tolist()
        return [dict(sorted(zip(names, row, strict=True), key=lambda pair: -pair[1])) for row in rows]


@cache
def shipped_proposer() -> Proposer:
    """The one in the package."""
    return Proposer(load(ProposalNet, WEIGHTS))
