"""The prior of a category: linear shape function S, joint function J, and how beta is distributed.

Everything is in category units. B observations, M keypoints, J joints, D = |beta|.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, pairwise

import torch
from torch import Tensor, nn

from .categories import Category
from .geometry import MIRROR_X
from .kinematics import KinematicTree, deform


@dataclass(frozen=True)
class JointParameters:
    """Joints in canonical space."""

    axes: Tensor
    """(B, J, 3) unit."""
    pivots: Tensor
    """(B, J, 3), zero for prismatic joints."""


def shape(basis: Tensor, beta: Tensor) -> Tensor:
    """S: ``P' = B beta`` (paper, Eq. 1). basis (M, 3, D), beta (B, D) -> keypoints (B, M, 3)."""
    return torch.einsum("mcd,bd->bmc", basis, beta)


@dataclass(frozen=True)
class MirrorMap:
    """Which keypoints are learned, and which are another's image in the plane x = 0."""

    source: tuple[int, ...]
    """(M,) index of the learned keypoint that stands behind each keypoint (itself where it is learned)."""
    is_image: tuple[bool, ...]
    """(M,)."""


def mirror_map(category: Category) -> MirrorMap:
    """A part that mirrors onto itself learns the first half of its keypoints; of two that swap, the first learns."""
    source: list[int] = []
    is_image: list[bool] = []
    start: list[int] = []
    for index, part in enumerate(category.parts):
        start.append(len(source))
        if part.mirror == index:
            first, images = start[index], part.keypoints // 2
        elif part.mirror is not None and part.mirror < index:
            first, images = start[part.mirror], part.keypoints
        else:
            first, images = start[index], 0
        learned = part.keypoints - images
        source += list(range(start[index], start[index] + learned)) + list(range(first, first + images))
        is_image += [False] * learned + [True] * images
    return MirrorMap(tuple(source), tuple(is_image))


class OmadPrior(nn.Module):
    """Shape basis and joint function (two-layer MLP with ReLU, paper Eq. 2) of one category."""

    def __init__(
        self,
        category: Category,
        basis_size: int | None = None,
        hidden: int = 64,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        self.tree: KinematicTree = category.tree
        self.basis_size = basis_size or category.basis_size
        ends = list(accumulate((part.keypoints for part in category.parts), initial=0))
        self.keypoints_of_part = tuple(slice(first, last) for first, last in pairwise(ends))
        mirror = mirror_map(category)
        learned = [i for i, image in enumerate(mirror.is_image) if not image]
        slot = [learned.index(i) for i in mirror.source]
        self.register_buffer("part_of", torch.tensor(category.part_of_keypoint), persistent=False)
        self.register_buffer("source", torch.tensor(mirror.source), persistent=False)
        self.register_buffer("slot", torch.tensor(slot), persistent=False)
        self.register_buffer("is_image", torch.tensor(mirror.is_image), persistent=False)
        axes = torch.tensor([joint.axis for joint in category.joints], dtype=torch.float32)
        self.register_buffer("nominal_axes", axes, persistent=False)
        self.register_buffer("revolute", torch.tensor(category.revolute), persistent=False)
        self.register_buffer("beta_mean", torch.zeros(self.basis_size))
        self.register_buffer("beta_covariance", torch.eye(self.basis_size))

        basis = 0.1 * torch.randn(len(learned), 3, self.basis_size, generator=generator)
        basis[..., 0] *= 5  # the first column starts as a spread-out cloud, so that no keypoints coincide
        self.learned_basis = nn.Parameter(basis)
        self.joint_hidden = nn.Linear(self.basis_size, hidden)
        self.joint_out = nn.Linear(hidden, 6 * len(category.joints))
        with torch.no_grad():
            for layer in (self.joint_hidden, self.joint_out):
                bound = layer.in_features**-0.5
                layer.weight.copy_((torch.rand(layer.weight.shape, generator=generator) * 2 - 1) * bound)
                layer.bias.zero_()

    part_of: Tensor
    source: Tensor
    slot: Tensor
    is_image: Tensor
    nominal_axes: Tensor
    revolute: Tensor
    beta_mean: Tensor
    beta_covariance: Tensor

    @property
    def num_keypoints(self) -> int:
        return len(self.part_of)

    @property
    def basis(self) -> Tensor:
        """B as (M, 3, D), images included; differentiable in the learned half."""
        full = self.learned_basis[self.slot]
        mirror = torch.tensor(MIRROR_X, dtype=full.dtype, device=full.device)[:, None]
        return torch.where(self.is_image[:, None, None], full * mirror, full)

    def keypoints(self, beta: Tensor) -> Tensor:
        """S(beta): (B, D) -> (B, M, 3) canonical space at rest."""
        return shape(self.basis, beta)

    def joints(self, beta: Tensor) -> JointParameters:
        """J(beta): the spec's axis plus a learned correction, normalised; pivots of revolute joints."""
        raw = self.joint_out(self.joint_hidden(beta).relu()).unflatten(-1, (-1, 6))
        axes = torch.nn.functional.normalize(self.nominal_axes + raw[..., :3], dim=-1)
        return JointParameters(axes=axes, pivots=raw[..., 3:] * self.revolute[:, None])

    def deform(self, beta: Tensor, states: Tensor, T_camera_base: Tensor) -> Tensor:
        """W(S(beta), J(beta), Theta): (B, D), (B, J), (B, 4, 4) -> keypoints in camera space (B, M, 3)."""
        joints = self.joints(beta)
        points = self.keypoints(beta)
        return deform(self.tree, self.part_of, points, joints.axes, joints.pivots, states, T_camera_base)

    def encode(self, keypoints: Tensor) -> Tensor:
        """The beta whose keypoints are nearest to canonical ``keypoints`` (B, M, 3), least squares -> (B, D)."""
        flat = self.basis.detach().reshape(-1, self.basis_size)
        return torch.linalg.lstsq(flat, keypoints.flatten(1).mT).solution.mT
