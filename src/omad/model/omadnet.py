"""OMADNet: a partial cloud -> coarse beta and joint states, keypoints with confidence, part labels.

Three branches on one PointNet++ (paper, section 4). The network works in an *input frame*: the camera
frame moved to the cloud's mean for a first look, the frame of its own first answer for a second one.
Everything in category units and radians.
"""

from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor, nn

from omad.geometry.transforms import make_transform, quaternion_to_matrix
from omad.objects.category import Category

from .backbones import SLIM, BackboneConfig, backbone_from_dict, backbone_to_dict
from .backbones.pointnet2 import interpolate
from .checkpoint import Network
from .prior import OmadPrior


@dataclass(frozen=True)
class Prediction:
    """What the network says of B clouds, in their input frames."""

    beta: Tensor
    """(B, |beta|)."""
    quaternion: Tensor
    """(B, 4) unit, rotation of the base."""
    translation: Tensor
    """(B, 3)."""
    states: Tensor
    """(B, J)."""
    keypoints: Tensor
    """(B, M, 3)."""
    log_sigma: Tensor
    """(B, M) log of each keypoint's expected error per coordinate, category units."""
    part_logits: Tensor
    """(B, N, K) for every input point."""

    @property
    def T_input_base(self) -> Tensor:
        """(B, 4, 4)."""
        return make_transform(quaternion_to_matrix(self.quaternion), self.translation)


class OmadNet(Network):
    """Backbone, three branches, and the prior that they speak the language of."""

    kind = "net"

    def __init__(
        self, category: Category, prior: OmadPrior, backbone: BackboneConfig = SLIM, attention: bool = True
    ) -> None:
        """``attention=False``: every centre's vote counts alike, to measure what the scores are good for."""
        super().__init__()
        self.category, self.attention = category, attention
        self.prior = prior.requires_grad_(False)
        self.backbone = backbone.build()
        width, dense = backbone.pooled, backbone.dense
        joints, keypoints, parts = len(category.joints), category.num_keypoints, len(category.parts)

        self.shape_branch = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, prior.basis_size))
        self.state_branch = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 7 + joints))
        self.keypoint_branch = nn.Sequential(nn.Linear(dense, dense), nn.ReLU(), nn.Linear(dense, 5 * keypoints))
        self.part_coarse = nn.Linear(dense, 32)
        self.part_fine = nn.Linear(3, 32, bias=False)
        self.part_out = nn.Linear(32, parts)

    def sizes(self) -> dict[str, Any]:
        return {"backbone": backbone_to_dict(self.backbone.config), "attention": self.attention}

    @classmethod
    def from_sizes(cls, category: Category, sizes: dict[str, Any]) -> Self:
        backbone = backbone_from_dict(sizes["backbone"])
        return cls(category, OmadPrior(category), backbone, sizes.get("attention", True))

    def forward(self, points: Tensor) -> Prediction:
        """points (B, N, 3) in the input frame, in random order."""
        features = self.backbone(points)
        state = self.state_branch(features.pooled)
        votes = self.keypoint_branch(features.dense).unflatten(-1, (-1, 5))  # (B, C, M, 5)
        scores = votes[..., 3] if self.attention else torch.zeros_like(votes[..., 3])
        attention = scores.softmax(1)
        placed = features.centres[:, :, None] + votes[..., :3]
        log_sigma = (attention * votes[..., 4]).sum(1) - 3.0  # starts near 0.05 units
        part = interpolate(points, features.centres, self.part_coarse(features.dense)) + self.part_fine(points / 0.2)
        return Prediction(
            beta=self.prior.beta_mean + self.shape_branch(features.pooled),
            quaternion=nn.functional.normalize(state[:, :4] + state.new_tensor([1e-3, 0, 0, 0]), dim=-1),
            translation=state[:, 4:7],
            states=state[:, 7:],
            keypoints=(attention[..., None] * placed).sum(1),  # paper, Eq. 7, with scores that sum to one
            log_sigma=log_sigma.clamp(-6.0, 1.0),
            part_logits=self.part_out(part.relu()),
        )
