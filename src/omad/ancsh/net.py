"""A-NCSH's network: OMADNet's backbone, carried to every point, with heads for parts, coordinates and joints."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn

from ..categories import Category
from ..pointnet2 import SLIM, BackboneConfig, Fuse, PointNet2, interpolate


@dataclass(frozen=True)
class AncshPrediction:
    """What the network says of the N points of B clouds; see ``coordinates``. No number depends on the camera."""

    part_logits: Tensor
    """(B, N, K)."""
    npcs: Tensor
    """(B, N, K, 3) for each part that the point might be of."""
    sizes: Tensor
    """(B, N, K) diagonal of each part in NAOCS, above 0."""
    centres: Tensor
    """(B, N, K, 3) box centre of each part in NAOCS."""
    heat: Tensor
    """(B, N, J) 0 to 1."""
    towards: Tensor
    """(B, N, J, 3) unit."""
    axes: Tensor
    """(B, N, J, 3) unit."""


class AncshNet(nn.Module):
    """Points in, part labels and normalised coordinates out. The size of an object is not told to it."""

    def __init__(self, category: Category, backbone: BackboneConfig = SLIM) -> None:
        super().__init__()
        self.category = category
        self.backbone = PointNet2(backbone)
        width, parts, joints = backbone.dense, len(category.parts), len(category.joints)
        self.propagate = Fuse(width, 3, width)
        self.part_head = _head(width, parts)
        self.npcs_head = _head(width, 3 * parts)
        self.naocs_head = _head(width, 4 * parts)
        self.joint_head = _head(width, 7 * joints)

    def forward(self, points: Tensor) -> AncshPrediction:
        """points (B, N, 3) in the input frame (``omad.omadnet``), category units, in random order."""
        features = self.backbone(points)
        dense = self.propagate(interpolate(points, features.centres, features.dense), points / 0.2)
        naocs = self.naocs_head(dense).unflatten(-1, (-1, 4))
        joints = self.joint_head(dense).unflatten(-1, (-1, 7))
        return AncshPrediction(
            part_logits=self.part_head(dense),
            npcs=self.npcs_head(dense).unflatten(-1, (-1, 3)),
            sizes=naocs[..., 0].clamp(-5.0, 5.0).exp(),
            centres=naocs[..., 1:],
            heat=joints[..., 0].sigmoid(),
            towards=nn.functional.normalize(joints[..., 1:4], dim=-1),
            axes=nn.functional.normalize(joints[..., 4:], dim=-1),
        )


def _head(width: int, out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, out))
