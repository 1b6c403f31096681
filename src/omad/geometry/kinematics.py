"""Kinematic trees and the deformation function W (paper, section 3.2 and supplementary).

A tree has one base (part 0) and one reference joint for every other part: joint ``j`` links part
``j + 1`` to the part ``parents[j]``. Axes and pivots are written in canonical space at rest, so the
transform of a part is the plain product, along the path from the root, of its joints'

    F = [R | (I - R) q + slide theta u],  R = R(u, turn theta)    axis u, pivot q, state theta
    F = [R | t]                                                    free: the base's pose in camera space

where ``turn`` and ``slide`` say what kind of joint it is (``joint_kinds``).

Shapes: B observations, J joints, K = J + 1 parts, M keypoints. Any float dtype; everything is
differentiable in every float argument.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .joint_kinds import Motion
from .transforms import axis_angle_to_matrix, make_transform


@dataclass(frozen=True)
class KinematicTree:
    """Which part hangs on which, and by what joint."""

    parents: tuple[int, ...]
    """Per joint, the parent part; the child of joint ``j`` is part ``j + 1`` and comes after its parent."""
    motions: tuple[Motion, ...]
    """Per joint, what a unit of its state does."""

    def __post_init__(self) -> None:
        if len(self.parents) != len(self.motions):
            raise ValueError(f"{len(self.parents)} parents but {len(self.motions)} joints' motions")
        for joint, parent in enumerate(self.parents):
            if not 0 <= parent <= joint:
                raise ValueError(f"joint {joint}: parent part {parent} must come before its child part {joint + 1}")

    @property
    def turning(self) -> tuple[bool, ...]:
        """Per joint, whether its state is an angle and its axis has a place."""
        return tuple(motion.turns for motion in self.motions)

    def scaled(self, factor: float) -> KinematicTree:
        """The same tree where lengths are ``factor`` times as many, in metres rather than category units, say."""
        return KinematicTree(self.parents, tuple(motion.scaled(factor) for motion in self.motions))

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.parents)

    @property
    def num_parts(self) -> int:
        """K: the base, and a part a joint."""
        return len(self.parents) + 1

    def path(self, part: int) -> tuple[int, ...]:
        """Joints from the root to ``part``, its own reference joint last; empty for the base."""
        joints: list[int] = []
        while part > 0:
            joints.append(part - 1)
            part = self.parents[part - 1]
        return tuple(reversed(joints))


def joint_transforms(tree: KinematicTree, axes: Tensor, pivots: Tensor, states: Tensor) -> Tensor:
    """F of every joint. axes (B, J, 3) unit, pivots (B, J, 3), states (B, J) -> (B, J, 4, 4)."""
    turn, slide = states.new_tensor([[motion.turn, motion.slide] for motion in tree.motions]).reshape(-1, 2).T
    rotation = axis_angle_to_matrix(axes, turn * states)
    around = pivots - (rotation @ pivots[..., None]).squeeze(-1)
    return make_transform(rotation, around + (slide * states)[..., None] * axes)


def part_transforms(tree: KinematicTree, axes: Tensor, pivots: Tensor, states: Tensor, T_camera_base: Tensor) -> Tensor:
    """G of every part: canonical rest coordinates -> camera. T_camera_base (B, 4, 4) -> (B, K, 4, 4)."""
    F = joint_transforms(tree, axes, pivots, states)
    G = [T_camera_base]
    for joint, parent in enumerate(tree.parents):
        G.append(G[parent] @ F[:, joint])
    return torch.stack(G, 1)


def deform(
    tree: KinematicTree,
    part_of: Tensor,
    keypoints: Tensor,
    axes: Tensor,
    pivots: Tensor,
    states: Tensor,
    T_camera_base: Tensor,
) -> Tensor:
    """W: canonical keypoints (B, M, 3), the m-th on part ``part_of[m]`` -> camera space (B, M, 3)."""
    G = part_transforms(tree, axes, pivots, states, T_camera_base)[:, part_of]
    return (G[..., :3, :3] @ keypoints[..., None]).squeeze(-1) + G[..., :3, 3]


@dataclass(frozen=True)
class JointLines:
    """Joint axes as lines in camera space."""

    axes: Tensor
    """(B, J, 3) unit."""
    pivots: Tensor
    """(B, J, 3), a point of each axis."""


def joint_lines(tree: KinematicTree, axes: Tensor, pivots: Tensor, G: Tensor) -> JointLines:
    """Carry canonical axes and pivots (B, J, 3) to camera space with part transforms G (B, K, 4, 4).

    Joint j moves with its parent part: axis ``R u``, pivot ``G q``.
    """
    parent = G[:, list(tree.parents)]
    rotated = (parent[..., :3, :3] @ axes[..., None]).squeeze(-1)
    moved = (parent[..., :3, :3] @ pivots[..., None]).squeeze(-1) + parent[..., :3, 3]
    return JointLines(axes=rotated, pivots=moved)
