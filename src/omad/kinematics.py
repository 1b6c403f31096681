"""Kinematic trees and the deformation function W (paper, section 3.2 and supplementary).

A tree has one base (part 0) and one reference joint for every other part: joint ``j`` links part
``j + 1`` to the part ``parents[j]``. Axes and pivots are written in canonical space at rest, so the
transform of a part is the plain product, along the path from the root, of its joints'

    F = [R(u, theta) | q - R(u, theta) q]    revolute, axis u, pivot q, state theta in radians
    F = [I | theta u]                        prismatic, state theta a length
    F = [R | t]                              free: the base's pose in camera space

Shapes: B observations, J joints, K = J + 1 parts, M keypoints. Any float dtype; everything is
differentiable in every float argument.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from .geometry import axis_angle_to_matrix, make_transform

JointType = Literal["revolute", "prismatic"]


@dataclass(frozen=True)
class KinematicTree:
    """Which part hangs on which, and by what joint."""

    parents: tuple[int, ...]
    """Per joint, the parent part; the child of joint ``j`` is part ``j + 1`` and comes after its parent."""
    types: tuple[JointType, ...]

    def __post_init__(self) -> None:
        if len(self.parents) != len(self.types):
            raise ValueError(f"{len(self.parents)} parents but {len(self.types)} joint types")
        for joint, (parent, kind) in enumerate(zip(self.parents, self.types, strict=True)):
            if not 0 <= parent <= joint:
                raise ValueError(f"joint {joint}: parent part {parent} must come before its child part {joint + 1}")
            if kind not in ("revolute", "prismatic"):
                raise ValueError(f"joint {joint}: unknown type {kind!r}, expected 'revolute' or 'prismatic'")

    @property
    def num_joints(self) -> int:
        return len(self.parents)

    @property
    def num_parts(self) -> int:
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
    revolute = torch.tensor([kind == "revolute" for kind in tree.types], dtype=torch.bool, device=states.device)
    angle = torch.where(revolute, states, torch.zeros_like(states))
    rotation = axis_angle_to_matrix(axes, angle)
    turn = pivots - (rotation @ pivots[..., None]).squeeze(-1)
    slide = states[..., None] * axes
    return make_transform(rotation, torch.where(revolute[:, None], turn, slide))


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
