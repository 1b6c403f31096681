"""OMAD-PriorNet: learns a category's prior from complete, part-labelled rest-state clouds, without keypoint labels.

Two branches look at one cloud (paper, section 3.3). The node branch makes M ordered nodes, each a
weighted mean of the points of its part; the shape branch makes beta. The losses pull nodes onto the
surface, spread them over their part, and tie them to ``B beta``, so that what survives in the shared
basis is what all objects of the category have in common.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor, nn

from omad.geometry.transforms import MIRROR_X
from omad.objects.category import Category

from .checkpoint import Network
from .prior import OmadPrior

WIDTH = 96
"""Features of a point."""


@dataclass(frozen=True)
class PriorNetOutput:
    """What both branches say of B clouds, in the clouds' unit."""

    nodes: Tensor
    """(B, M, 3) ordered nodes."""
    beta: Tensor
    """(B, |beta|)."""


class PriorNet(Network):
    """Node and shape branch over a shared per-point encoder, and the prior that they teach."""

    kind = "prior"

    def __init__(self, category: Category, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.category = category
        self.prior = OmadPrior(category, generator=generator)
        parts = len(category.parts)
        first, second, third = nn.Linear(6 + parts, WIDTH), nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH)
        self.encoder = nn.Sequential(first, nn.ReLU(), second, nn.ReLU(), third)
        self.node_layer = nn.Linear(WIDTH + 3, WIDTH)
        self.context_layer = nn.Linear(parts * WIDTH, WIDTH, bias=False)
        self.node_head = nn.Linear(WIDTH, category.num_keypoints)
        self.shape_head = nn.Sequential(
            nn.Linear(parts * (WIDTH + 6), 2 * WIDTH), nn.ReLU(), nn.Linear(2 * WIDTH, self.prior.shape_size)
        )
        self.register_buffer("part_of", torch.tensor(category.part_of_keypoint), persistent=False)

    part_of: Tensor

    @classmethod
    def from_sizes(cls, category: Category, sizes: dict[str, Any]) -> Self:
        return cls(category)

    def forward(self, clouds: Sequence[Tensor]) -> PriorNetOutput:
        """clouds: of every part (B, n, 3), canonical at rest in category units; n may differ from part to part."""
        counts = [cloud.shape[1] for cloud in clouds]
        low, high = part_boxes(clouds)
        centre, half = (high + low) / 2, ((high - low) / 2).clamp(min=1e-3)
        each = torch.arange(len(clouds), device=low.device).repeat_interleave(torch.tensor(counts, device=low.device))
        points = torch.cat(list(clouds), 1)
        local = (points - centre[:, each]) / half[:, each]
        member = nn.functional.one_hot(each, len(clouds)).to(points).expand(len(points), -1, -1)
        features = self.encoder(torch.cat([points, local, member], -1))
        pooled = torch.stack([own.amax(1) for own in features.split(counts, 1)], 1)  # (B, K, WIDTH)
        context = self.context_layer(pooled.flatten(1))[:, None]
        hidden = (self.node_layer(torch.cat([features, local], -1)) + context).relu().split(counts, 1)
        nodes = [
            nn.functional.linear(own, self.node_head.weight[of], self.node_head.bias[of]).softmax(1).mT @ cloud
            for own, cloud, of in zip(hidden, clouds, self.prior.keypoints_of_part, strict=True)
        ]
        nodes = torch.cat(nodes, 1)
        images = nodes[:, self.prior.source] * nodes.new_tensor(MIRROR_X)  # of the learned partners
        shape = self.shape_head(torch.cat([pooled, low, high], -1).flatten(1))
        beta = nn.functional.pad(shape, (0, self.prior.basis_size - self.prior.shape_size))
        return PriorNetOutput(torch.where(self.prior.is_image[:, None], images, nodes), beta)


def part_boxes(clouds: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Corners (B, K, 3) of the axis-aligned boxes around points (B, n, 3) of each part."""
    return torch.stack([cloud.amin(1) for cloud in clouds], 1), torch.stack([cloud.amax(1) for cloud in clouds], 1)
