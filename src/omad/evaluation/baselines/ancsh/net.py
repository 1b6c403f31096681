"""A-NCSH's network: OMADNet's backbone, carried to every point, with heads for parts, coordinates and joints."""

from dataclasses import dataclass
from functools import partial
from typing import Any, Self

from torch import Tensor, nn

from omad.model.backbones import SLIM, BackboneConfig, backbone_from_dict, backbone_to_dict
from omad.model.backbones.point_ops import interpolate
from omad.model.backbones.pointnet2 import Fuse
from omad.model.checkpoint import Network
from omad.objects.category import Category


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


class AncshNet(Network):
    """Points in, part labels and normalised coordinates out. The size of an object is not told to it."""

    kind = "ancsh"

    def __init__(self, category: Category, backbone: BackboneConfig = SLIM) -> None:
        super().__init__()
        self.category = category
        self.backbone = backbone.build()
        width, parts, joints = backbone.dense, len(category.parts), len(category.joints)
        self.propagate = Fuse(width, 3, width)
        self.part_head = _head(width, parts)
        self.npcs_head = _head(width, 3 * parts)
        self.naocs_head = _head(width, 4 * parts)
        self.joint_head = _head(width, 7 * joints)

    def sizes(self) -> dict[str, Any]:
        return {"backbone": backbone_to_dict(self.backbone.config)}

    @classmethod
    def from_sizes(cls, category: Category, sizes: dict[str, Any]) -> Self:
        return cls(category, backbone_from_dict(sizes["backbone"]))

    def forward(self, points: Tensor) -> AncshPrediction:
        """points (B, N, 3) in the input frame (``omad.model.omadnet``), category units, in random order."""
        features = self.backbone(points)
        dense = self.propagate(features.dense, points / 0.2, partial(interpolate, points, features.centres))
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
