"""OMAD-PriorNet: learns a category's prior from complete, part-labelled rest-state clouds, without keypoint labels.

Two branches look at one cloud (paper, section 3.3). The node branch makes M ordered nodes, each a
weighted mean of the points of its part; the shape branch makes beta. The losses pull nodes onto the
surface, spread them over their part, and tie them to ``B beta``, so that what survives in the shared
basis is what all objects of the category have in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from .categories import Category
from .geometry import MIRROR_X
from .losses import coverage_loss, joint_loss, part_chamfer, part_extents, separation_loss, surface_loss
from .prior import OmadPrior


@dataclass(frozen=True)
class PriorNetOutput:
    nodes: Tensor
    """(B, M, 3) ordered nodes."""
    beta: Tensor
    """(B, |beta|)."""


@dataclass(frozen=True)
class PriorLossWeights:
    """The paper's weights. Our own: ``order`` ties the i-th node to the i-th keypoint, and a wider separation."""

    chamfer: float = 1.0
    coverage: float = 1.0
    surface: float = 5.0
    separation: float = 2.0
    joint: float = 1.0
    beta: float = 0.01
    order: float = 1.0
    separation_share: float = 1 / 5
    """Smallest distance between keypoints of a part, as a share of its box diagonal (paper: 1/8)."""


class PriorNet(nn.Module):
    """Node and shape branch over a shared per-point encoder, and the prior that they teach."""

    def __init__(self, category: Category, width: int = 96, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.category = category
        self.prior = OmadPrior(category, generator=generator)
        parts = len(category.parts)
        self.encoder = nn.Sequential(
            nn.Linear(6 + parts, width),
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Linear(width, width),
        )
        self.node_layer = nn.Linear(width + 3, width)
        self.context_layer = nn.Linear(parts * width, width, bias=False)
        self.node_head = nn.Linear(width, category.num_keypoints)
        self.shape_head = nn.Sequential(
            nn.Linear(parts * (width + 6), 2 * width), nn.ReLU(), nn.Linear(2 * width, self.prior.basis_size)
        )
        self.register_buffer("part_of", torch.tensor(category.part_of_keypoint), persistent=False)

    part_of: Tensor

    def forward(self, points: Tensor, labels: Tensor) -> PriorNetOutput:
        """points (B, N, 3) canonical at rest in category units, labels (B, N)."""
        parts = len(self.category.parts)
        member = labels[:, None] == torch.arange(parts, device=labels.device)[:, None]  # (B, K, N)
        low, high = part_extents(points, member)
        box = ((high + low) / 2).gather(1, labels[..., None].expand(-1, -1, 3))
        half = ((high - low) / 2).clamp(min=1e-3).gather(1, labels[..., None].expand(-1, -1, 3))
        local = (points - box) / half
        features = self.encoder(torch.cat([points, local, member.mT.to(points.dtype)], -1))
        pooled = torch.stack(
            [features.masked_fill(~member[:, k, :, None], -torch.inf).amax(1) for k in range(parts)], 1
        )  # (B, K, width)
        context = self.context_layer(pooled.flatten(1))[:, None]
        logits = self.node_head((self.node_layer(torch.cat([features, local], -1)) + context).relu())  # (B, N, M)
        own = labels[..., None] == self.part_of
        attention = logits.masked_fill(~own, -torch.inf).softmax(1)
        nodes = self._mirror(attention.mT @ points)
        beta = self.shape_head(torch.cat([pooled, low, high], -1).flatten(1))
        return PriorNetOutput(nodes=nodes, beta=beta)

    def _mirror(self, nodes: Tensor) -> Tensor:
        """Replace every mirrored node by the image of its learned partner."""
        mirror = torch.tensor(MIRROR_X, dtype=nodes.dtype, device=nodes.device)
        return torch.where(self.prior.is_image[:, None], nodes[:, self.prior.source] * mirror, nodes)


def prior_losses(
    net: PriorNet, points: Tensor, labels: Tensor, axes: Tensor, pivots: Tensor, weights: PriorLossWeights
) -> dict[str, Tensor]:
    """Every term of the loss, weighted; their sum is the loss. Shapes as in PriorNet.forward; joints (B, J, 3)."""
    out = net(points, labels)
    prior, part_of = net.prior, net.part_of
    keypoints = prior.keypoints(out.beta)
    joints = prior.joints(out.beta)
    parts = torch.arange(len(net.category.parts), device=labels.device)
    low, high = part_extents(points, labels[:, None] == parts[:, None])
    return {
        "chamfer": weights.chamfer * part_chamfer(out.nodes, keypoints, part_of),
        "order": weights.order * (out.nodes - keypoints).norm(dim=-1).mean(),
        "coverage": weights.coverage * coverage_loss(out.nodes, part_of, low, high),
        "surface": weights.surface * surface_loss(out.nodes, part_of, points, labels),
        "separation": weights.separation * separation_loss(out.nodes, part_of, low, high, weights.separation_share),
        "joint": weights.joint * joint_loss(joints.axes, joints.pivots, axes, pivots, prior.revolute),
        "beta": weights.beta * out.beta.square().mean(),
    }
