"""OMAD-PriorNet: learns a category's prior from complete, part-labelled rest-state clouds, without keypoint labels.

Two branches look at one cloud (paper, section 3.3). The node branch makes M ordered nodes, each a
weighted mean of the points of its part; the shape branch makes beta. The losses pull nodes onto the
surface, spread them over their part, and tie them to ``B beta``, so that what survives in the shared
basis is what all objects of the category have in common.
"""

from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor, nn

from omad.geometry.transforms import MIRROR_X
from omad.objects.category import Category

from .checkpoint import Network
from .prior import OmadPrior


@dataclass(frozen=True)
class PriorNetOutput:
    nodes: Tensor
    """(B, M, 3) ordered nodes."""
    beta: Tensor
    """(B, |beta|)."""


class PriorNet(Network):
    """Node and shape branch over a shared per-point encoder, and the prior that they teach."""

    kind = "prior"

    def __init__(self, category: Category, width: int = 96, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.category = category
        self.prior = OmadPrior(category, generator=generator)
        parts = len(category.parts)
        first, second, third = nn.Linear(6 + parts, width), nn.Linear(width, width), nn.Linear(width, width)
        self.encoder = nn.Sequential(first, nn.ReLU(), second, nn.ReLU(), third)
        self.node_layer = nn.Linear(width + 3, width)
        self.context_layer = nn.Linear(parts * width, width, bias=False)
        self.node_head = nn.Linear(width, category.num_keypoints)
        self.shape_head = nn.Sequential(
            nn.Linear(parts * (width + 6), 2 * width), nn.ReLU(), nn.Linear(2 * width, self.prior.basis_size)
        )
        self.register_buffer("part_of", torch.tensor(category.part_of_keypoint), persistent=False)

    part_of: Tensor

    @classmethod
    def from_sizes(cls, category: Category, sizes: dict[str, Any]) -> Self:
        return cls(category)

    def forward(self, points: Tensor, labels: Tensor) -> PriorNetOutput:
        """points (B, N, 3) canonical at rest in category units, labels (B, N)."""
        parts = len(self.category.parts)
        member = labels[:, None] == torch.arange(parts, device=labels.device)[:, None]  # (B, K, N)
        low, high = part_extents(points, member)
        of_point = labels[..., None].expand(-1, -1, 3)
        half = ((high - low) / 2).clamp(min=1e-3).gather(1, of_point)
        local = (points - ((high + low) / 2).gather(1, of_point)) / half
        features = self.encoder(torch.cat([points, local, member.mT.to(points.dtype)], -1))
        own = [features.masked_fill(~inside[..., None], -torch.inf).amax(1) for inside in member.unbind(1)]
        pooled = torch.stack(own, 1)  # (B, K, width)
        context = self.context_layer(pooled.flatten(1))[:, None]
        logits = self.node_head((self.node_layer(torch.cat([features, local], -1)) + context).relu())  # (B, N, M)
        attention = logits.masked_fill(labels[..., None] != self.part_of, -torch.inf).softmax(1)
        nodes = attention.mT @ points
        images = nodes[:, self.prior.source] * nodes.new_tensor(MIRROR_X)  # of the learned partners
        beta = self.shape_head(torch.cat([pooled, low, high], -1).flatten(1))
        return PriorNetOutput(torch.where(self.prior.is_image[:, None], images, nodes), beta)


def part_extents(points: Tensor, member: Tensor) -> tuple[Tensor, Tensor]:
    """Corners (B, K, 3) of each part's axis-aligned box; ``member`` broadcasts to (B, K, P)."""
    inside, spread = member[..., None], points[:, None]
    return torch.where(inside, spread, torch.inf).amin(2), torch.where(inside, spread, -torch.inf).amax(2)
