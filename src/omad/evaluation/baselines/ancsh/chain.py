"""Part poses held together by their joints: one small least-squares problem an object.

Unknowns: the object's scale, and the rotation and translation of every part. Residuals: where a part's inliers are
against where the pose puts them, and what the joints forbid:

    turning     both parts see the same axis direction, and the same point of the axis
    sliding     both parts are turned alike, and are shifted along the axis only

A part's inliers enter as twelve numbers, however many they are: a sum of squares that is quadratic in the pose matrix
[scale R | t] equals that of the 3x4 matrix [scale R | t] F - Y, with F F^T the moments of the points.
B objects, K parts, J joints, category units.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from omad.geometry.kinematics import KinematicTree
from omad.geometry.least_squares import Linearisation, TerminationConfig, minimise
from omad.geometry.transforms import skew, so3_exp
from omad.model.prior import JointParameters


@dataclass(frozen=True)
class ChainConfig:
    """How much joints count beside the points: residuals are weighted so, against a mean error of one over points."""

    turn: float = 1.0
    """Per radian between what two parts say of their joint's direction."""
    shift: float = 0.3
    """Per category unit between what they say of its place."""
    termination: TerminationConfig = TerminationConfig(max_iterations=30, step_tolerance=1e-5, cost_tolerance=1e-7)


@dataclass(frozen=True)
class PartPoses:
    """Parts in the camera frame: ``camera = scale * R @ naocs + t``."""

    scale: Tensor
    """(B,) category units: the object's diagonal."""
    rotations: Tensor
    """(B, K, 3, 3)."""
    translations: Tensor
    """(B, K, 3)."""


def part_moments(naocs: Tensor, camera: Tensor, inliers: Tensor) -> tuple[Tensor, Tensor]:
    """What a part's inliers say of its pose: F (B, K, 4, 4) and Y (B, K, 3, 4) of points (B, K, P, 3) with weights
    ``inliers`` (B, K, P), which add up to one over an object. A direction in which the points do not vary is left out:
    it says nothing."""
    weights = inliers.to(naocs)
    weights = weights / weights.sum((1, 2), keepdim=True).clamp(min=1e-12)
    one = torch.cat([naocs, torch.ones_like(naocs[..., :1])], -1)
    weighted = weights[..., None] * one
    spread, directions = torch.linalg.eigh(weighted.mT @ one)
    known = spread > 1e-9 * spread[..., -1:].clamp(min=1e-12)
    root = torch.where(known, spread, 0.0).sqrt()
    inverse = torch.where(known, 1 / torch.where(known, root, 1.0), 0.0)
    return directions * root[..., None, :], camera.mT @ weighted @ directions * inverse[..., None, :]


def hold_together(
    tree: KinematicTree,
    start: PartPoses,
    F: Tensor,
    Y: Tensor,
    joints: JointParameters,
    held: Tensor,
    config: ChainConfig,
) -> PartPoses:
    """Refine part poses from ``start``; joints in NAOCS count where ``held`` (B, J), where both their parts are seen. A
    part without inliers and without such a joint stays where it is."""
    K = tree.num_parts

    def pack(poses: PartPoses) -> Tensor:
        return torch.cat([poses.scale.log()[:, None], poses.rotations.flatten(1), poses.translations.flatten(1)], 1)

    def unpack(x: Tensor) -> PartPoses:
        scale, rotations, translations = x.split((1, 9 * K, 3 * K), 1)
        return PartPoses(scale[:, 0].exp(), rotations.unflatten(1, (K, 3, 3)), translations.unflatten(1, (K, 3)))

    def linearise(x: Tensor, index: Tensor) -> Linearisation:
        poses = unpack(x)
        blocks = [of_points(poses, F[index], Y[index])]
        for j, (parent, turns) in enumerate(zip(tree.parents, tree.turning, strict=True)):
            axis, pivot, on = joints.axes[index, j], joints.pivots[index, j], held[index, j].to(x)[:, None]
            block = of_joint(poses, parent, j + 1, axis, pivot, turns, config)
            blocks.append(Linearisation(block.residuals * on, block.jacobian * on[..., None]))
        return Linearisation(*(torch.cat([vars(block)[n] for block in blocks], 1) for n in ("residuals", "jacobian")))

    def retract(x: Tensor, step: Tensor, index: Tensor) -> Tensor:
        poses, moves = unpack(x), step[:, 1:].unflatten(1, (K, 6))
        rotations = so3_exp(moves[..., :3]) @ poses.rotations
        return pack(PartPoses(poses.scale * step[:, 0].exp(), rotations, poses.translations + moves[..., 3:]))

    return unpack(minimise(linearise, pack(start), retract, termination=config.termination, far=False).x)


def of_points(poses: PartPoses, F: Tensor, Y: Tensor) -> Linearisation:
    """Where the poses put a part's points against where they are; (B, 12 K) residuals."""
    B, K = poses.translations.shape[:2]
    turned = poses.scale[:, None, None, None] * poses.rotations
    residuals = torch.cat([turned, poses.translations[..., None]], -1) @ F - Y
    eye = torch.eye(3, dtype=turned.dtype, device=turned.device)
    by = turned.new_zeros(B, K, 7, 3, 4)  # of the pose matrix: by scale, rotation vector, translation
    by[:, :, 0, :, :3] = turned
    by[:, :, 1:4, :, :3] = skew(eye) @ turned[:, :, None]
    by[:, :, 4:, :, 3] = eye
    by = (by @ F[:, :, None]).flatten(3).mT  # (B, K, 12, 7)
    jacobian = turned.new_zeros(B, K, 12, 1 + 6 * K)
    jacobian[..., 0] = by[..., 0]
    for k in range(K):
        jacobian[:, k, :, 1 + 6 * k : 7 + 6 * k] = by[:, k, :, 1:]
    return Linearisation(residuals.flatten(1), jacobian.flatten(1, 2))


def of_joint(
    poses: PartPoses, parent: int, child: int, axis: Tensor, pivot: Tensor, turns: bool, config: ChainConfig
) -> Linearisation:
    """What parent and child must agree on, with the joint's ``axis`` and ``pivot`` (B, 3). Directions: the axis where
    the joint turns, else all three of a part's. A place: the pivot where it turns, else the part's origin, and that but
    across the axis as the parent turns it. (B, 6) or (B, 12) residuals."""
    R, t = poses.rotations, poses.translations
    along = (R[:, parent] @ axis[..., None]).squeeze(-1)
    alike = (R @ axis[:, None, :, None]).mT if turns else R.mT / 2**0.5  # (B, K, directions, 3)
    arms = turns * poses.scale[:, None, None] * (R @ pivot[:, None, :, None]).squeeze(-1)
    across = torch.eye(3).to(t).expand(len(t), 3, 3) if turns else -skew(along)
    gap = (arms + t)[:, parent] - (arms + t)[:, child]

    V = 3 * alike.shape[2]
    jacobian = t.new_zeros(len(t), V + 3, 1 + 6 * t.shape[1])
    jacobian[:, V:, 0] = (across @ (arms[:, parent] - arms[:, child])[..., None]).squeeze(-1)
    for part, sign in ((parent, 1.0), (child, -1.0)):
        first = 1 + 6 * part
        jacobian[:, :V, first : first + 3] = -sign * skew(alike[:, part]).flatten(1, 2)
        jacobian[:, V:, first : first + 3] = -sign * across @ skew(arms[:, part])
        jacobian[:, V:, first + 3 : first + 6] = sign * across
    if not turns:  # the parent turns the axis that shifts may be along
        jacobian[:, V:, 1 + 6 * parent : 4 + 6 * parent] = -skew(gap) @ skew(along)
    residuals = torch.cat([(alike[:, parent] - alike[:, child]).flatten(1), (across @ gap[..., None]).squeeze(-1)], 1)
    weights = t.new_tensor([config.turn] * V + [config.shift] * 3)
    return Linearisation(weights * residuals, weights[:, None] * jacobian)
