"""OMADNet: a partial cloud -> coarse beta and joint states, keypoints with confidence, part labels.

Three branches on one PointNet++ (paper, section 4). The network works in an *input frame*: the camera
frame moved to the cloud's mean for a first look, the frame of its own first answer for a second one.
Everything in category units and radians.
"""

from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor, nn

from omad.common.decode import decode
from omad.geometry.transforms import make_transform, quaternion_to_matrix
from omad.objects.category import Category

from .backbones import SLIM, BackboneConfig, backbone_from_dict, backbone_to_dict
from .backbones.point_ops import interpolate
from .checkpoint import Network
from .prior import OmadPrior

NEW_CLASS = {"part_out.weight": (0, 0, 0, 1), "part_out.bias": (0, 1)}
"""Weights that have a row more for points outside the object, and where it stands."""
OWN = ("prior.", "shape_branch.2.", "state_branch.2.", "keypoint_branch.2.", "part_out.")
"""What a network has of its category alone: its prior, and the layers that speak of its parts, joints and keypoints."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """What the network says of B clouds, in their input frames."""

    beta: Tensor
    """(B, D)."""
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
    pooled: Tensor
    """(B, pooled) what the backbone knows of the whole cloud."""
    part_logits: Tensor
    """(B, N, K) for every input point, or (B, 0, K): of the parts, and where the network tells them, one more of points
    that are not on the object."""

    @property
    def T_input_base(self) -> Tensor:
        """(B, 4, 4)."""
        return make_transform(quaternion_to_matrix(self.quaternion), self.translation)


class OmadNet(Network):
    """Backbone, three branches, and the prior that they speak the language of."""

    kind = "net"

    def __init__(
        self,
        category: Category,
        prior: OmadPrior,
        backbone: BackboneConfig = SLIM,
        attention: bool = True,
        tells_outside: bool = False,
        own_states: float = 0.0,
    ) -> None:
        """``attention=False``: every centre's vote counts alike, to measure what the scores are good for.
        ``tells_outside``: it labels points that are not on the object, too. ``own_states``: share of the network's own
        joint states in answers; the rest is what its keypoints say, which knows objects unlike those of the training
        less well."""
        super().__init__()
        self.category, self.attention, self.tells_outside = category, attention, tells_outside
        self.own_states = own_states
        self.prior = prior.requires_grad_(False)
        self.backbone = backbone.build()
        width, dense = backbone.pooled, backbone.dense
        joints, keypoints, parts = len(category.joints), category.num_keypoints, len(category.parts)

        self.shape_branch = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, prior.shape_size))
        self.state_branch = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 7 + joints))
        self.keypoint_branch = nn.Sequential(nn.Linear(dense, dense), nn.ReLU(), nn.Linear(dense, 5 * keypoints))
        self.part_coarse = nn.Linear(dense, 32)
        self.part_fine = nn.Linear(3, 32, bias=False)
        self.part_out = nn.Linear(32, parts + tells_outside)

    def sizes(self) -> dict[str, Any]:
        told = {"attention": self.attention, "tells_outside": self.tells_outside, "own_states": self.own_states}
        return {"backbone": backbone_to_dict(self.backbone.config), **told}

    @classmethod
    def from_sizes(cls, category: Category, sizes: dict[str, Any]) -> Self:
        backbone = backbone_from_dict(sizes["backbone"])
        attention, outside = (
            decode(bool, sizes.get(*name)) for name in (("attention", True), ("tells_outside", False))
        )
        own_states = decode(float, sizes.get("own_states", 0.0))
        if not 0 <= own_states <= 1:
            raise ValueError(f"own_states: is {own_states}; give a share from 0 to 1")
        return cls(category, OmadPrior(category), backbone, attention, outside, own_states)

    def start_from(self, other: Self) -> None:
        """Take over the weights of another network, which may tell no points outside the object yet. Where its prior is
        another one, its beta is translated: keypoints stay where they were, as nearly as the own basis can."""
        weights = {name: tensor for name, tensor in other.state_dict().items() if not name.startswith("prior.")}
        if self.tells_outside and not other.tells_outside:
            weights |= {name: nn.functional.pad(weights[name], pad) for name, pad in NEW_CLASS.items()}
        if not torch.equal(self.prior.learned_basis, other.prior.learned_basis):
            translate = self.prior.encode(other.prior.basis.permute(2, 0, 1)).mT[: self.prior.shape_size]
            translate = translate[:, : other.prior.shape_size]
            weight, bias = weights["shape_branch.2.weight"], weights["shape_branch.2.bias"]
            theirs, own = (prior.beta_mean[: prior.shape_size] for prior in (other.prior, self.prior))
            bias = translate @ (theirs + bias) - own
            weights |= {"shape_branch.2.weight": translate @ weight, "shape_branch.2.bias": bias}
        self.load_state_dict(weights | self.prior.state_dict(prefix="prior."))

    def learn_from(self, other: Self) -> None:
        """Begin with what a network of another category or another prior knows of clouds: all layers but the last of
        each branch, and of these the base's pose. The backbones are alike."""
        theirs = other.state_dict()
        known = {name: tensor for name, tensor in theirs.items() if not name.startswith(OWN)}
        self.load_state_dict(self.state_dict() | known)
        with torch.no_grad():
            for name in ("weight", "bias"):
                getattr(self.state_branch[2], name)[:7] = theirs[f"state_branch.2.{name}"][:7]

    def forward(self, points: Tensor, labels: bool = True) -> Prediction:
        """points (B, N, 3) in the input frame, in random order; without ``labels`` the ``part_logits`` are of none."""
        features = self.backbone(points)
        votes = self.keypoint_branch(features.dense).unflatten(-1, (-1, 5))  # (B, C, M, 5)
        scores = votes[..., 3] if self.attention else torch.zeros_like(votes[..., 3])
        attention = scores.softmax(1)
        placed = features.centres[:, :, None] + votes[..., :3]
        keypoints = (attention[..., None] * placed).sum(1)  # paper, Eq. 7, with scores that sum to one
        log_sigma = (attention * votes[..., 4]).sum(1)
        points = points if labels else points[:, :0]
        part = interpolate(points, features.centres, self.part_coarse(features.dense)) + self.part_fine(points / 0.2)
        return self.prediction(features.pooled, keypoints, log_sigma, self.part_out(part.relu()))

    def prediction(self, pooled: Tensor, keypoints: Tensor, log_sigma: Tensor, part_logits: Tensor) -> Prediction:
        """What the network says, with what two of its branches say of the whole cloud: ``pooled`` (B, pooled)."""
        state, shape = self.state_branch(pooled), self.shape_branch(pooled)
        return Prediction(
            beta=self.prior.beta_mean + nn.functional.pad(shape, (0, self.prior.basis_size - self.prior.shape_size)),
            quaternion=nn.functional.normalize(state[:, :4] + state.new_tensor([1e-3, 0, 0, 0]), dim=-1),
            translation=state[:, 4:7],
            states=state[:, 7:],
            keypoints=keypoints,
            log_sigma=(log_sigma - 3.0).clamp(-6.0, 1.0),  # starts near 0.05 units
            pooled=pooled,
            part_logits=part_logits,
        )
