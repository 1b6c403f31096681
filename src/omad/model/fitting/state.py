"""What the fit seeks, what it is given, and what it found.

The unknowns' order, and that of every tangent step (B, P) with P = 6 + J + D: omega (3), a rotation of the base in
camera axes, R <- exp(omega) R; its translation (3); joint states theta (J); shape parameters beta (D). Category units
and radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from omad.geometry.transforms import make_transform, so3_exp


@dataclass(frozen=True, eq=False)
class State:
    """The unknowns of B observations."""

    beta: Tensor
    """(B, D)."""
    joint_states: Tensor
    """(B, J)."""
    T_camera_base: Tensor
    """(B, 4, 4)."""

    def moved(self, step: Tensor) -> State:
        """After a tangent step (B, P); differentiable in it."""
        T, joints = self.T_camera_base, self.joint_states.shape[1]
        omega, t, theta, beta = step.split((3, 3, joints, self.beta.shape[1]), 1)
        pose = make_transform(so3_exp(omega) @ T[:, :3, :3], T[:, :3, 3] + t)
        return State(self.beta + beta, self.joint_states + theta, pose)

    def pack(self) -> Tensor:
        """(B, 16 + J + D), one row an observation."""
        return torch.cat([self.T_camera_base.flatten(1), self.joint_states, self.beta], 1)

    @classmethod
    def unpack(cls, rows: Tensor, joints: int) -> State:
        """The inverse of ``pack``."""
        return cls(rows[:, 16 + joints :], rows[:, 16 : 16 + joints], rows[:, :16].unflatten(1, (4, 4)))


@dataclass(frozen=True, eq=False)
class Targets:
    """Where the keypoints of B observations are seen."""

    keypoints: Tensor
    """(B, M, 3) camera frame."""
    weights: Tensor
    """(B, M) 1 / sigma^2 of each; 0 leaves one out, whatever its coordinates."""


@dataclass(frozen=True, eq=False)
class Refined:
    """What became of B observations."""

    state: State
    """The unknowns: shape, joint states, base pose."""
    covariance: Tensor
    """(B, P, P) of the unknowns in tangent coordinates (omega, t, theta, beta), from J^T J; zero for held ones, very
    large where a direction is not observed, NaN where a problem is broken."""
    converged: Tensor
    """(B,) bool."""
    iterations: Tensor
    """(B,) int64."""
    energy: Tensor
    """(B,) sum of weighted squared keypoint distances."""
    residual: Tensor
    """(B,) RMS keypoint distance over the keypoints with weight."""

    @classmethod
    def of(
        cls, state: State, points: Tensor, targets: Targets, covariance: Tensor, converged: Tensor, iterations: Tensor
    ) -> Refined:
        """With the distances of the state's keypoints ``points`` (B, M, 3) from their targets."""
        counts = targets.weights != 0
        squared = torch.where(counts, (points - targets.keypoints).square().sum(-1), 0.0)
        residual = (squared.sum(-1) / counts.sum(-1).clamp(min=1)).sqrt()
        return cls(state, covariance, converged, iterations, (targets.weights * squared).sum(-1), residual)


def covariance_of(hessian: Tensor, free: Tensor) -> Tensor:
    """(B, P, P) of ``Refined.covariance``, from J^T J (B, F, F) over the free directions (P, F)."""
    return free @ _inverse(hessian) @ free.mT


def _inverse(hessian: Tensor) -> Tensor:
    """Inverse of each J^T J: very large where a direction is not observed, NaN where it is broken."""
    diagonal = hessian.diagonal(dim1=-2, dim2=-1)
    root = torch.where(diagonal > 0, diagonal, torch.where(diagonal == 0, 1e-12, torch.nan)).sqrt()
    scale = root[..., None] * root[..., None, :]
    eye = torch.eye(hessian.shape[-1]).to(hessian)
    # Scaled to a unit diagonal, whatever the units, a singular matrix needs only this much to be invertible.
    factor, info = torch.linalg.cholesky_ex(hessian / scale + 1e-12 * eye)
    bad = (info != 0)[:, None, None]
    return torch.where(bad, torch.nan, torch.cholesky_inverse(torch.where(bad, eye, factor)) / scale)
