"""Part poses held together by their joints: one small least-squares problem an object.

Unknowns: the object's scale, and the rotation and translation of every part. Residuals: where a part's inliers are
against where the pose puts them, and what the joints forbid:

    revolute    both parts see the same axis direction, and the same point of the axis
    prismatic   both parts are turned alike, and are shifted along the axis only

A part's inliers enter as twelve numbers, however many they are: a sum of squares that is quadratic in the pose matrix
[scale R | t] equals that of the 3x4 matrix [scale R | t] F - Y, with F F^T the moments of the points.
B objects, K parts, J joints, category units.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..geometry import skew, so3_exp
from ..kinematics import KinematicTree
from ..least_squares import Linearisation, TerminationConfig, minimise
from .votes import VotedJoints


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


@dataclass(frozen=True)
class PartMoments:
    """What a part's inliers say of its pose."""

    F: Tensor
    """(B, K, 4, 4)."""
    Y: Tensor
    """(B, K, 3, 4)."""


def part_moments(naocs: Tensor, camera: Tensor, inliers: Tensor) -> PartMoments:
    """Moments of points (B, K, P, 3) with weights ``inliers`` (B, K, P), which add up to one over an object.

    A direction in which the points do not vary is left out: it says nothing.
    """
    weights = inliers.to(naocs)
    weights = weights / weights.sum((1, 2), keepdim=True).clamp(min=1e-12)
    one = torch.cat([naocs, torch.ones_like(naocs[..., :1])], -1)
    weighted = weights[..., None] * one
    spread, directions = torch.linalg.eigh(weighted.mT @ one)
    known = spread > 1e-9 * spread[..., -1:].clamp(min=1e-12)
    root = torch.where(known, spread, 0.0).sqrt()
    inverse = torch.where(known, 1 / torch.where(known, root, 1.0), 0.0)
    cross = camera.mT @ weighted
    return PartMoments(F=directions * root[..., None, :], Y=cross @ directions * inverse[..., None, :])


def hold_together(
    tree: KinematicTree, start: PartPoses, moments: PartMoments, joints: VotedJoints, held: Tensor, config: ChainConfig
) -> PartPoses:
    """Refine part poses from ``start``; joints count where ``held`` (B, J), that is, where both their parts are seen.

    A part without inliers and without such a joint stays where it is.
    """
    K = tree.num_parts

    def pack(poses: PartPoses) -> Tensor:
        return torch.cat([poses.scale.log()[:, None], poses.rotations.flatten(1), poses.translations.flatten(1)], 1)

    def unpack(x: Tensor) -> PartPoses:
        rotations = x[:, 1 : 1 + 9 * K].unflatten(1, (K, 3, 3))
        return PartPoses(x[:, 0].exp(), rotations, x[:, 1 + 9 * K :].unflatten(1, (K, 3)))

    def linearise(x: Tensor, index: Tensor) -> Linearisation:
        poses = unpack(x)
        blocks = [_of_points(poses, PartMoments(moments.F[index], moments.Y[index]))]
        for j in range(tree.num_joints):
            axis, pivot, on = joints.axes[index, j], joints.pivots[index, j], held[index, j]
            of_joint = _of_revolute if tree.types[j] == "revolute" else _of_prismatic
            block = of_joint(poses, tree.parents[j], j + 1, axis, pivot, config)
            on = on.to(x)[:, None]
            blocks.append(Linearisation(block.residuals * on, block.jacobian * on[..., None]))
        return Linearisation(
            torch.cat([block.residuals for block in blocks], 1), torch.cat([block.jacobian for block in blocks], 1)
        )

    def retract(x: Tensor, step: Tensor, index: Tensor) -> Tensor:
        poses, moves = unpack(x), step[:, 1:].unflatten(1, (K, 6))
        return pack(
            PartPoses(
                scale=poses.scale * step[:, 0].exp(),
                rotations=so3_exp(moves[..., :3]) @ poses.rotations,
                translations=poses.translations + moves[..., 3:],
            )
        )

    return unpack(minimise(linearise, pack(start), retract, termination=config.termination).x)


def _of_points(poses: PartPoses, moments: PartMoments) -> Linearisation:
    B, K = poses.translations.shape[:2]
    turned = poses.scale[:, None, None, None] * poses.rotations
    pose = torch.cat([turned, poses.translations[..., None]], -1)
    residuals = pose @ moments.F - moments.Y
    eye = torch.eye(3, dtype=turned.dtype, device=turned.device)
    by = turned.new_zeros(B, K, 7, 3, 4)  # of the pose matrix: by scale, rotation vector, translation
    by[:, :, 0, :, :3] = turned
    by[:, :, 1:4, :, :3] = skew(eye) @ turned[:, :, None]
    by[:, :, 4:, :, 3] = eye
    by = (by @ moments.F[:, :, None]).flatten(3).mT  # (B, K, 12, 7)
    jacobian = turned.new_zeros(B, K, 12, 1 + 6 * K)
    jacobian[..., 0] = by[..., 0]
    for k in range(K):
        jacobian[:, k, :, 1 + 6 * k : 7 + 6 * k] = by[:, k, :, 1:]
    return Linearisation(residuals.flatten(1), jacobian.flatten(1, 2))


def _of_revolute(
    poses: PartPoses, parent: int, child: int, axis: Tensor, pivot: Tensor, config: ChainConfig
) -> Linearisation:
    """Axis and pivot as parent and child place them; (B, 6) residuals."""
    directions = _turned(poses, axis)
    arms = poses.scale[:, None, None] * _turned(poses, pivot)
    places = arms + poses.translations
    residuals = torch.cat(
        [
            config.turn * (directions[:, parent] - directions[:, child]),
            config.shift * (places[:, parent] - places[:, child]),
        ],
        1,
    )
    jacobian = _empty(poses, 6)
    jacobian[:, 3:, 0] = config.shift * (arms[:, parent] - arms[:, child])
    eye = torch.eye(3, dtype=axis.dtype, device=axis.device)
    for part, sign in ((parent, 1.0), (child, -1.0)):
        first = 1 + 6 * part
        jacobian[:, :3, first : first + 3] = -sign * config.turn * skew(directions[:, part])
        jacobian[:, 3:, first : first + 3] = -sign * config.shift * skew(arms[:, part])
        jacobian[:, 3:, first + 3 : first + 6] = sign * config.shift * eye
    return Linearisation(residuals, jacobian)


def _of_prismatic(
    poses: PartPoses, parent: int, child: int, axis: Tensor, pivot: Tensor, config: ChainConfig
) -> Linearisation:
    """Rotations of parent and child, and their shift across the axis; (B, 12) residuals."""
    direction = _turned(poses, axis)[:, parent]
    shift = poses.translations[:, child] - poses.translations[:, parent]
    columns = poses.rotations.mT  # rows are where a part's three axes point
    residuals = torch.cat(
        [
            config.turn / 2**0.5 * (columns[:, parent] - columns[:, child]).flatten(1),
            config.shift * torch.linalg.cross(direction, shift, dim=-1),
        ],
        1,
    )
    jacobian = _empty(poses, 12)
    for part, sign in ((parent, 1.0), (child, -1.0)):
        first = 1 + 6 * part
        by_turn = -sign * config.turn / 2**0.5 * skew(columns[:, part])
        jacobian[:, :9, first : first + 3] = by_turn.flatten(1, 2)
        jacobian[:, 9:, first + 3 : first + 6] = -sign * config.shift * skew(direction)
    first = 1 + 6 * parent
    jacobian[:, 9:, first : first + 3] = config.shift * skew(shift) @ skew(direction)
    return Linearisation(residuals, jacobian)


def _turned(poses: PartPoses, vector: Tensor) -> Tensor:
    """A NAOCS vector (B, 3) as every part turns it -> (B, K, 3)."""
    return (poses.rotations @ vector[:, None, :, None]).squeeze(-1)


def _empty(poses: PartPoses, rows: int) -> Tensor:
    B, K = poses.translations.shape[:2]
    return poses.translations.new_zeros(B, rows, 1 + 6 * K)
