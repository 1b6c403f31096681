"""From what the network says of a cloud to the poses of its parts and the joints between them.

    1. RANSAC and similarity alignment of every part's NPCS with its points
    2. joints by vote in NAOCS
    3. all parts anew, held together by their joints
    4. joint states from the poses of the two parts

A part with too few points is missing, and so are the states of its joints: they are NaN. A joint's axis is there as
long as one of the two parts that it links is.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..categories import Category
from ..geometry import make_transform, matrix_to_quaternion
from .chain import ChainConfig, PartPoses, hold_together, part_moments
from .coordinates import pick
from .net import AncshPrediction
from .similarity import RansacConfig, ransac
from .votes import VotedJoints, vote_joints


@dataclass(frozen=True)
class AlignmentConfig:
    """How parts are aligned."""

    ransac: RansacConfig = RansacConfig()
    chain: ChainConfig = ChainConfig()
    fewest_points: int = 10
    """A part with fewer, or with fewer inliers, is missing."""
    seed: int = 0


@dataclass(frozen=True)
class Poses:
    """B objects in the camera frame, category units and radians; NaN is missing."""

    states: Tensor
    """(B, J)."""
    axes: Tensor
    """(B, J, 3) unit."""
    pivots: Tensor
    """(B, J, 3)."""
    T_camera_part: Tensor
    """(B, K, 4, 4) canonical rest coordinates to camera."""


@dataclass(frozen=True)
class Alignment:
    """What became of B clouds."""

    separate: Poses
    """Every part by itself."""
    joined: Poses
    """Held together by the joints."""
    labels: Tensor
    """(B, N) part of each point."""
    found: Tensor
    """(B, K) bool, parts that are not missing."""


@torch.no_grad()
def align(points: Tensor, said: AncshPrediction, category: Category, config: AlignmentConfig) -> Alignment:
    """points (B, N, 3) in the camera frame, category units, in random order; ``said`` of them by the network."""
    labels = said.part_logits.argmax(-1)
    member = labels[:, None] == torch.arange(len(category.parts), device=labels.device)[:, None]  # (B, K, N)
    npcs = said.npcs.gather(2, labels[..., None, None].expand(-1, -1, 1, 3)).squeeze(2)
    sizes = _mean_over(said.sizes[..., None], member).squeeze(-1).clamp(min=1e-3)
    centres = _mean_over(said.centres, member)
    naocs = pick(sizes, labels)[..., None] * npcs + pick(centres, labels)
    voted = vote_joints(said, labels, naocs, category)

    # the first points of every part, packed; points come in random order
    P = min(config.ransac.points, points.shape[1])
    index = member.to(torch.int8).sort(dim=2, descending=True, stable=True).indices[..., :P]
    index = index.flatten(1)[..., None].expand(-1, -1, 3)
    part_npcs, part_points = (values.gather(1, index).unflatten(1, (-1, P)) for values in (npcs, points))
    count = member.sum(-1).clamp(max=P)
    generator = torch.Generator().manual_seed(config.seed)
    consensus = ransac(part_npcs, part_points, count, config.ransac, generator)

    inliers, similarity = consensus.inliers, consensus.similarity
    found = inliers.sum(-1) >= config.fewest_points
    inliers = inliers & found[..., None]
    sizes, centres, voted = sizes.double(), centres.double(), VotedJoints(voted.axes.double(), voted.pivots.double())
    rotations, middles = similarity.rotation.double(), similarity.translation.double()
    scales = torch.where(found, similarity.scale.double() / sizes, 1.0)
    separate = middles - scales[..., None] * (rotations @ centres[..., None]).squeeze(-1)

    share = inliers.sum(-1) / inliers.sum((1, 2)).clamp(min=1)[:, None]
    common = (share * scales.log()).sum(1).exp()
    together = middles - common[:, None, None] * (rotations @ centres[..., None]).squeeze(-1)
    part_naocs = sizes[..., None, None] * part_npcs.double() + centres[:, :, None]
    joined = hold_together(
        category.tree,
        PartPoses(common, rotations, together),
        part_moments(part_naocs, part_points.double(), inliers),
        voted,
        held=found[:, 1:] & found[:, list(category.tree.parents)],
        config=config.chain,
    )
    every = joined.scale[:, None].expand_as(scales)
    return Alignment(
        separate=_poses(rotations, separate, scales, voted, found, category),
        joined=_poses(joined.rotations, joined.translations, every, voted, found, category),
        labels=labels,
        found=found,
    )


def _mean_over(values: Tensor, member: Tensor) -> Tensor:
    """Mean (B, K, C) over each part's points, ``member`` (B, K, N), of what they say of it, values (B, N, K, C)."""
    weights = member.to(values) / member.sum(-1, keepdim=True).clamp(min=1)
    return torch.einsum("bkn,bnkc->bkc", weights, values)


def _poses(
    rotations: Tensor, translations: Tensor, scales: Tensor, voted: VotedJoints, found: Tensor, category: Category
) -> Poses:
    """rotations (B, K, 3, 3), translations (B, K, 3), scales (B, K): ``camera = scale * R @ naocs + t``."""
    parent, child = list(category.tree.parents), slice(1, None)
    back = rotations[:, parent].mT
    turn = matrix_to_quaternion(back @ rotations[:, child])
    # the part of the turn that is about the axis: where joints are not held, a rest of it is not
    angles = 2 * torch.atan2((turn[..., 1:] * voted.axes).sum(-1), turn[..., 0])
    shift = (back @ (translations[:, child] - translations[:, parent])[..., None]).squeeze(-1)
    revolute = torch.tensor(category.revolute, device=angles.device)
    states = torch.where(revolute, angles, (shift * voted.axes).sum(-1))
    known = found[:, child] & found[:, parent]

    # a joint is carried to the camera by its parent, or where that is missing by its child
    def carrier(values: Tensor) -> Tensor:
        seen = found[:, parent].reshape(*known.shape, *[1] * (values.dim() - 2))
        return torch.where(seen, values[:, parent], values[:, child])

    R, t, scale = carrier(rotations), carrier(translations), carrier(scales)
    pivots = scale[..., None] * (R @ voted.pivots[..., None]).squeeze(-1) + t
    either = (found[:, child] | found[:, parent])[..., None]
    T = make_transform(rotations, translations)
    return Poses(
        states=torch.where(known, states, torch.nan),
        axes=torch.where(either, (R @ voted.axes[..., None]).squeeze(-1), torch.nan),
        pivots=torch.where(either, pivots, torch.nan),
        T_camera_part=torch.where(found[..., None, None], T, torch.nan),
    )
