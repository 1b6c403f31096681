"""From what the network says of a cloud to the poses of its parts and the joints between them.

    1. RANSAC and similarity alignment of every part's NPCS with its points
    2. joints by vote in NAOCS
    3. all parts anew, held together by their joints
    4. joint states from the poses of the two parts

A part with too few points is missing, and so are the states of its joints: they are NaN. A joint's axis is there as
long as one of the two parts that it links is.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from omad.geometry.transforms import make_transform, matrix_to_quaternion
from omad.model.prior import JointParameters
from omad.objects.category import Category

from .chain import ChainConfig, PartPoses, hold_together, part_moments
from .coordinates import HEAT_RADIUS, linked, of_own_part, pick
from .net import AncshPrediction
from .similarity import RansacConfig, ransac

ROUNDS = 5
"""Of Weiszfeld's iteration."""


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
    npcs = of_own_part(said.npcs, labels)
    sizes = _mean_over(said.sizes[..., None], member).squeeze(-1).clamp(min=1e-3)
    centres = _mean_over(said.centres, member)
    voted = _vote(said, labels, pick(sizes, labels)[..., None] * npcs + pick(centres, labels), category)

    # the first points of every part, packed; points come in random order
    P = min(config.ransac.points, points.shape[1])
    index = member.to(torch.int8).sort(dim=2, descending=True, stable=True).indices[..., :P]
    index = index.flatten(1)[..., None].expand(-1, -1, 3)
    part_npcs, part_points = (values.gather(1, index).unflatten(1, (-1, P)) for values in (npcs, points))
    count = member.sum(-1).clamp(max=P)
    generator = torch.Generator().manual_seed(config.seed)
    similarity, inliers = ransac(part_npcs, part_points, count, config.ransac, generator)

    found = inliers.sum(-1) >= config.fewest_points
    inliers = inliers & found[..., None]
    sizes, centres = sizes.double(), centres.double()
    voted = JointParameters(voted.axes.double(), voted.pivots.double())
    rotations, middles = similarity.rotation.double(), similarity.translation.double()
    scales = torch.where(found, similarity.scale.double() / sizes, 1.0)
    arms = _turned(rotations, centres)

    share = inliers.sum(-1) / inliers.sum((1, 2)).clamp(min=1)[:, None]
    common = (share * scales.log()).sum(1).exp()
    naocs = sizes[..., None, None] * part_npcs.double() + centres[:, :, None]
    F, Y = part_moments(naocs, part_points.double(), inliers)
    start = PartPoses(common, rotations, middles - common[:, None, None] * arms)
    held = found[:, 1:] & found[:, list(category.tree.parents)]
    joined = hold_together(category.tree, start, F, Y, voted, held, config.chain)
    every = joined.scale[:, None].expand_as(scales)
    return Alignment(
        separate=_poses(rotations, middles - scales[..., None] * arms, scales, voted, found, category),
        joined=_poses(joined.rotations, joined.translations, every, voted, found, category),
        labels=labels,
        found=found,
    )


def _mean_over(values: Tensor, member: Tensor) -> Tensor:
    """Mean (B, K, C) over each part's points, ``member`` (B, K, N), of what they say of it, values (B, N, K, C)."""
    weights = member.to(values) / member.sum(-1, keepdim=True).clamp(min=1)
    return torch.einsum("bkn,bnkc->bkc", weights, values)


def _vote(said: AncshPrediction, labels: Tensor, naocs: Tensor, category: Category) -> JointParameters:
    """Joints in NAOCS, median of what points say of each: how its axis points, and those near it where it is. labels
    (B, N), naocs (B, N, 3). Of no meaning where no point is of a part that the joint links.

    A joint that turns is told by the points of the two parts it links, by their heat (squared: where no point is near
    the axis the nearest still decide); one that slides by all points of its parts.
    """
    turning = torch.tensor(category.turning, device=naocs.device)
    weights = linked(labels, category) * torch.where(turning, said.heat.square(), 1.0)
    places = naocs[:, :, None] + said.towards * ((1 - said.heat) * HEAT_RADIUS)[..., None]
    axes = torch.nn.functional.normalize(_median(said.axes, weights), dim=-1)
    return JointParameters(axes, _median(places, weights) * turning[:, None])


def _median(values: Tensor, weights: Tensor) -> Tensor:
    """Weighted geometric median (B, J, 3) of values (B, N, J, 3) with weights (B, N, J): Weiszfeld's iteration."""
    pull, middle = weights, values[:, 0]
    for _ in range(ROUNDS + 1):
        middle = (pull[..., None] * values).sum(1) / pull.sum(1).clamp(min=1e-12)[..., None]
        pull = weights / (values - middle[:, None]).norm(dim=-1).clamp(min=1e-3)
    return middle


def _turned(rotations: Tensor, vectors: Tensor) -> Tensor:
    """Each of the vectors (..., 3) by its own rotation (..., 3, 3)."""
    return (rotations @ vectors[..., None]).squeeze(-1)


def _poses(
    rotations: Tensor, translations: Tensor, scales: Tensor, voted: JointParameters, found: Tensor, category: Category
) -> Poses:
    """rotations (B, K, 3, 3), translations (B, K, 3), scales (B, K): ``camera = scale * R @ naocs + t``."""
    parent, child = list(category.tree.parents), slice(1, None)
    back = rotations[:, parent].mT
    turn = matrix_to_quaternion(back @ rotations[:, child])
    # the part of the turn that is about the axis: where joints are not held, a rest of it is not
    angles = 2 * torch.atan2((turn[..., 1:] * voted.axes).sum(-1), turn[..., 0])
    shifts = (_turned(back, translations[:, child] - translations[:, parent]) * voted.axes).sum(-1)
    states = torch.where(torch.tensor(category.turning, device=angles.device), angles, shifts)

    # a joint is carried to the camera by its parent, or where that is missing by its child
    carrier = torch.where(found[:, parent], *torch.tensor([parent, range(1, 1 + len(parent))], device=found.device))
    R, t, scale = (pick(values, carrier) for values in (rotations, translations, scales))
    either = (found[:, child] | found[:, parent])[..., None]
    return Poses(
        states=torch.where(found[:, child] & found[:, parent], states, torch.nan),
        axes=torch.where(either, _turned(R, voted.axes), torch.nan),
        pivots=torch.where(either, scale[..., None] * _turned(R, voted.pivots) + t, torch.nan),
        T_camera_part=torch.where(found[..., None, None], make_transform(rotations, translations), torch.nan),
    )
