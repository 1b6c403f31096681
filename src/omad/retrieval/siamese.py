"""The baseline of retrieval: a Siamese PointNet++ with contrastive loss (Hadsell, Chopra and LeCun 2006)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..categories import Category
from ..pointnet2 import SLIM, BackboneConfig, PointNet2

EMBEDDING = 32
"""Numbers that a view is known by."""
MARGIN = 1.0
"""Distance beyond which views of different objects are left alone."""


class SiameseNet(nn.Module):
    """OMADNet's backbone, and one vector from its global feature."""

    def __init__(self, category: Category, backbone: BackboneConfig = SLIM, size: int = EMBEDDING) -> None:
        super().__init__()
        self.category = category
        self.size = size
        self.backbone = PointNet2(backbone)
        width = backbone.widths[2]
        self.head = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, size))

    def forward(self, points: Tensor) -> Tensor:
        """points (B, N, 3) in the input frame (``omad.omadnet``), category units, in random order -> (B, size)."""
        return self.head(self.backbone(points).pooled)


def contrastive_losses(embeddings: Tensor, objects: Tensor, margin: float = MARGIN) -> dict[str, Tensor]:
    """Both terms of the contrastive loss over all pairs of a batch: (B, E) embeddings of ``objects`` (B,).

    ``same`` draws views of one object together, ``other`` pushes those of two apart as far as the margin; each is the
    mean over its pairs, so that the few of the one kind count like the many of the other.
    """
    first, second = torch.triu_indices(len(objects), len(objects), offset=1, device=objects.device)
    squared = (embeddings[first] - embeddings[second]).square().sum(-1)
    alike = objects[first] == objects[second]
    short = (margin - squared.add(1e-12).sqrt()).clamp(min=0).square()
    return {
        "same": (squared * alike).sum() / alike.sum().clamp(min=1),
        "other": (short * ~alike).sum() / (~alike).sum().clamp(min=1),
    }
