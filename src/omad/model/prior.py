"""The prior of a category: linear shape function S, joint function J, and how beta is distributed.

Everything is in category units. B observations, M keypoints, J joints, D = |beta|.
"""

from copy import copy
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from omad.common.arrays import as_doubles
from omad.geometry.kinematics import KinematicTree, deform
from omad.geometry.transforms import MIRROR_X
from omad.objects.category import Category


@dataclass(frozen=True, eq=False)
class JointParameters:
    """Joints in canonical space."""

    axes: Tensor
    """(B, J, 3) unit."""
    pivots: Tensor
    """(B, J, 3), zero where the axis has no place."""


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
        first, images = start[index], 0
        if part.mirror is not None and part.mirror <= index:
            first, images = start[part.mirror], part.keypoints // (2 if part.mirror == index else 1)
        learned = part.keypoints - images
        source += [*range(start[index], start[index] + learned), *range(first, first + images)]
        is_image += [False] * learned + [True] * images
    return MirrorMap(tuple(source), tuple(is_image))


class OmadPrior(nn.Module):
    """Shape basis and joint function (two-layer MLP with ReLU, paper Eq. 2) of one category.

    Our own: beta may end in a few loose numbers, which no keypoint depends on. They move pivots as those of the
    category's objects lie off what the joint function makes of their shapes, so that an estimate's hinges are where
    its parts turn about, and parts of unusual make do not turn farther, or less far, to make up for it."""

    def __init__(
        self,
        category: Category,
        basis_size: int | None = None,
        hidden: int = 64,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        self.tree: KinematicTree = category.tree
        size = basis_size or category.basis_size
        ends = list(accumulate((part.keypoints for part in category.parts), initial=0))
        self.keypoints_of_part = tuple(slice(first, last) for first, last in pairwise(ends))
        mirror = mirror_map(category)
        learned = [i for i, image in enumerate(mirror.is_image) if not image]
        fixed = {"part_of": category.part_of_keypoint, "source": mirror.source, "is_image": mirror.is_image}
        fixed["slot"], fixed["turning"] = [learned.index(i) for i in mirror.source], category.turning
        fixed["nominal_axes"] = [[float(x) for x in joint.axis] for joint in category.joints]
        for name, values in fixed.items():
            self.register_buffer(name, torch.tensor(values), persistent=False)
        self.register_buffer("beta_mean", torch.zeros(size))
        self.register_buffer("beta_covariance", torch.eye(size))

        basis = 0.1 * torch.randn(len(learned), 3, size, generator=generator)
        basis[..., 0] *= 5  # the first column starts as a spread-out cloud, so that no keypoints coincide
        self.learned_basis = nn.Parameter(basis)
        self.joint_hidden = nn.Linear(size, hidden)
        self.joint_out = nn.Linear(hidden, 6 * len(category.joints))
        with torch.no_grad():
            for layer in (self.joint_hidden, self.joint_out):
                bound = layer.in_features**-0.5
                layer.weight.copy_((torch.rand(layer.weight.shape, generator=generator) * 2 - 1) * bound)
                layer.bias.zero_()
        self.register_buffer("pivot_basis", torch.zeros(len(category.joints), 3, 0), persistent=False)

    part_of: Tensor
    source: Tensor
    slot: Tensor
    is_image: Tensor
    nominal_axes: Tensor
    turning: Tensor
    beta_mean: Tensor
    beta_covariance: Tensor
    pivot_basis: Tensor
    """(J, 3, L) category units a standard deviation of each loose number."""

    @property
    def shape_size(self) -> int:
        """Of the basis: beta without its loose numbers."""
        return self.learned_basis.shape[-1]

    @property
    def basis_size(self) -> int:
        """D, of all of beta."""
        return len(self.beta_mean)

    def loosen(self, pivot_basis: Tensor) -> None:
        """Let beta end in L loose numbers, independent and of unit variance, that move pivots by ``pivot_basis``
        (J, 3, L), in place of those that it ends in."""
        size, loose = self.shape_size, pivot_basis.shape[-1]
        self.beta_mean = nn.functional.pad(self.beta_mean[:size], (0, loose))
        self.beta_covariance = torch.block_diag(self.beta_covariance[:size, :size], torch.eye(loose).to(pivot_basis))
        self.register_buffer("pivot_basis", pivot_basis, persistent=loose > 0)

    def _load_from_state_dict(self, state_dict: dict[str, Tensor], prefix: str, *args: Any) -> None:
        """With as many loose numbers as the weights have."""
        found = state_dict.get(f"{prefix}pivot_basis")
        loose = 0 if found is None or not found.dim() else found.shape[-1]
        self.loosen(self.pivot_basis.new_zeros(*self.pivot_basis.shape[:2], loose))
        super()._load_from_state_dict(state_dict, prefix, *args)

    @property
    def num_keypoints(self) -> int:
        """Of all parts together."""
        return len(self.part_of)

    def repeated(self, times: int) -> Self:
        """The same prior with every keypoint so many times, one after the other, for targets that have each of them so
        often. Parameters are shared."""
        if times == 1:
            return self
        other = copy(self)
        names = "part_of", "source", "slot", "is_image"
        other._buffers = self._buffers | {name: getattr(self, name).repeat_interleave(times) for name in names}
        other.keypoints_of_part = tuple(slice(times * of.start, times * of.stop) for of in self.keypoints_of_part)
        return other

    @property
    def basis(self) -> Tensor:
        """B as (M, 3, D), images included; differentiable in the learned half."""
        full = nn.functional.pad(self.learned_basis, (0, self.basis_size - self.shape_size))[self.slot]
        return torch.where(self.is_image[:, None, None], full * full.new_tensor(MIRROR_X)[:, None], full)

    def keypoints(self, beta: Tensor) -> Tensor:
        """S(beta) = B beta (paper, Eq. 1): (B, D) -> (B, M, 3) canonical space at rest."""
        return torch.einsum("mcd,bd->bmc", self.basis, beta)

    def joints(self, beta: Tensor) -> JointParameters:
        """J(beta): the spec's axis plus a learned correction, normalised; a pivot where the joint turns, moved by the
        loose numbers."""
        raw = self._joint_layers(self.joint_hidden(beta[:, : self.shape_size]))
        pivots = raw[..., 3:] + torch.einsum("jcl,bl->bjc", self.pivot_basis, beta[:, self.shape_size :])
        return JointParameters(nn.functional.normalize(raw[..., :3], dim=-1), pivots * self.turning[:, None])

    def joint_slopes(self, beta: Tensor) -> JointParameters:
        """d J / d beta at beta (B, D), in closed form; axes and pivots (B, J, 3, D)."""
        hidden = self.joint_hidden(beta[:, : self.shape_size])
        axes = self._joint_layers(hidden)[..., :3]
        length = axes.norm(dim=-1, keepdim=True)
        axes = axes / length
        slope = self.joint_out.weight @ ((hidden > 0).to(beta)[..., None] * self.joint_hidden.weight)
        slope = slope.unflatten(1, (-1, 6))
        tangent = (torch.eye(3).to(beta) - axes[..., None] * axes[..., None, :]) / length[..., None]
        pivots = torch.cat([slope[:, :, 3:], self.pivot_basis.expand(len(beta), -1, -1, -1)], -1)
        directions = nn.functional.pad(tangent @ slope[:, :, :3], (0, self.basis_size - self.shape_size))
        return JointParameters(directions, pivots * self.turning[:, None, None])

    def _joint_layers(self, hidden: Tensor) -> Tensor:
        """(B, J, 6) axes that are not normalised yet and pivots, from the hidden layer before its ReLU."""
        raw = self.joint_out(hidden.relu()).unflatten(-1, (-1, 6))
        return raw + nn.functional.pad(self.nominal_axes, (0, 3))

    def deform(self, beta: Tensor, states: Tensor, T_camera_base: Tensor) -> Tensor:
        """W(S(beta), J(beta), Theta): (B, D), (B, J), (B, 4, 4) -> keypoints in camera space (B, M, 3)."""
        points, joints = self.keypoints(beta), self.joints(beta)
        return deform(self.tree, self.part_of, points, joints.axes, joints.pivots, states, T_camera_base)

    def encode(self, keypoints: Tensor) -> Tensor:
        """The beta whose keypoints are nearest to canonical ``keypoints`` (B, M, 3), least squares -> (B, D)."""
        # PyTorch's own solver gives other last digits in every run, and a basis of few objects makes much of them
        inverse = np.linalg.pinv(as_doubles(self.basis.detach()).reshape(-1, self.basis_size))
        doubles = keypoints.flatten(1).double()
        return (doubles @ torch.as_tensor(inverse.T).to(doubles)).to(keypoints)
