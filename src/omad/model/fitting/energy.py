"""The energy of the fit (paper, Eq. 9) as a sum of squares, linearised.

    sum_i w_i |W(S(beta), J(beta), Theta)_i - target_i|^2      (robustified)
    + prior_weight * (beta - mean)^T covariance^-1 (beta - mean)
    + soft joint limits

Category units and radians; the unknowns' order is that of ``state``.
"""

import math
from dataclasses import dataclass
from typing import Literal, Self, get_args

import torch
from torch import Tensor
from torch.nn.functional import pad

from omad.common.errors import InputError
from omad.geometry.kinematics import part_transforms
from omad.geometry.least_squares import Linearisation, TerminationConfig, TrustRegionConfig
from omad.geometry.transforms import skew

from ..prior import OmadPrior
from .state import State, Targets

Backend = Literal["auto", "torch", "kernel"]


@dataclass(frozen=True)
class RefinementConfig:
    """What the energy consists of and how it is minimised."""

    prior_weight: float = 1.0
    """Weight of the Gaussian prior on beta; 0 switches it off."""
    limit_sigma: float = 0.02
    """A joint state this far outside its limits (radians or category units) costs what a keypoint a sigma off does."""
    huber: float | None = 3.0
    """Keypoints further than this many sigmas from their targets pull linearly instead of quadratically."""
    max_iterations: int = 60
    """Of the least squares."""
    step_tolerance: float = 1e-7
    """Steps shorter than this end it."""
    cost_tolerance: float = 1e-10
    """See ``least_squares.TerminationConfig``."""
    trust_region: TrustRegionConfig = TrustRegionConfig()
    """How far steps may go."""
    backend: Backend = "auto"
    """'auto': the fused kernel (always float64) on the CPU, torch (in the dtype of the targets) elsewhere."""

    def __post_init__(self) -> None:
        if self.backend not in get_args(Backend):
            raise InputError(f"RefinementConfig: backend is {self.backend!r}; give {' or '.join(get_args(Backend))}")
        if not (self.huber is None or self.huber > 0):
            raise InputError(f"RefinementConfig: huber is {self.huber}; give a number above 0, or None")
        if not 0 <= self.prior_weight < math.inf:
            raise InputError(f"RefinementConfig: prior_weight is {self.prior_weight}; give 0, or a number above it")
        if not self.limit_sigma > 0:
            raise InputError(f"RefinementConfig: limit_sigma is {self.limit_sigma}; give a number above 0")

    @property
    def termination(self) -> TerminationConfig:
        """When it ends."""
        return TerminationConfig(self.max_iterations, self.step_tolerance, self.cost_tolerance)


@dataclass(frozen=True)
class ShapePrior:
    """A Gaussian on beta, weighted."""

    mean: Tensor
    """(D,)."""
    whitening: Tensor
    """(D, D) upper triangular L, float64: |L (beta - mean)|^2 is the weighted squared Mahalanobis distance."""

    @classmethod
    def of(cls, mean: Tensor, covariance: Tensor, weight: float) -> Self:
        """From mean (D,) and covariance (D, D). A direction in which the training objects hardly vary counts as a
        thousandth of the widest one's spread, so that few objects, or alike ones, still make a usable prior."""
        spread, directions = torch.linalg.eigh(covariance.double())
        spread = spread.clamp(min=1e-6 * float(spread[-1].clamp(min=1e-12)))
        return cls(mean, torch.linalg.qr((weight / spread).sqrt()[:, None] * directions.mT).R)


@torch.no_grad()
def keypoint_jacobian(prior: OmadPrior, state: State) -> tuple[Tensor, Tensor]:
    """Camera-space keypoints (B, M, 3) and their derivative (B, M, 3, P) by the unknowns, in closed form. The tests
    hold it to forward-mode differentiation of ``prior.deform``, which takes four to nine times as long."""
    tree, joints, slopes = prior.tree, prior.joints(state.beta), prior.joint_slopes(state.beta)
    axes, pivots, canonical = joints.axes, joints.pivots, prior.keypoints(state.beta)
    R, t = state.T_camera_base[:, :3, :3], state.T_camera_base[:, :3, 3]
    eye = torch.eye(3).to(R)
    origin = torch.eye(4).to(R).expand(len(R), 4, 4)
    G = part_transforms(tree, axes, pivots, state.joint_states, origin)  # part -> base frame

    A = G[:, prior.part_of, :3, :3]
    points = (A @ canonical[..., None]).squeeze(-1) + G[:, prior.part_of, :3, 3]  # base frame
    by_states = points.new_zeros(*points.shape, tree.num_joints)
    by_beta = torch.einsum("bmij,mjd->bmid", A, prior.basis)
    for part in range(1, tree.num_parts):
        members = prior.keypoints_of_part[part]
        below = canonical[:, members]  # the keypoint in canonical coordinates, before the joint at hand moves it
        for joint in reversed(tree.path(part)):
            rotation = G[:, tree.parents[joint], :3, :3]
            theta, motion = state.joint_states[:, joint, None, None], tree.motions[joint]
            u, q = axes[:, None, joint], pivots[:, None, joint]
            slide, cos, sin = motion.slide * theta, (motion.turn * theta).cos(), (motion.turn * theta).sin()
            arm = below - q
            along = (arm * u).sum(-1, keepdim=True)
            turned = cos * arm + sin * torch.linalg.cross(u, arm) + (1 - cos) * along * u
            d_theta = motion.turn * torch.linalg.cross(u, turned) + motion.slide * u
            outer = u[..., None] * arm[..., None, :]
            by_u = (slide + (1 - cos) * along)[..., None] * eye + (1 - cos)[..., None] * outer
            by_u = by_u - sin[..., None] * skew(arm)
            by_q = (1 - cos) * (eye - axes[:, joint, :, None] * u) - sin * skew(axes[:, joint])  # I - R(u, turn theta)
            d_beta = by_u @ slopes.axes[:, None, joint] + (by_q @ slopes.pivots[:, joint])[:, None]
            by_states[:, members, :, joint] = d_theta @ rotation.mT
            by_beta[:, members] += rotation[:, None] @ d_beta
            below = turned + q + slide * u
    camera = points @ R.mT
    d_omega, moving = -skew(camera), R[:, None] @ torch.cat([by_states, by_beta], -1)
    return camera + t[:, None], torch.cat([d_omega, eye.expand_as(d_omega), moving], -1)


def linearise(
    prior: OmadPrior,
    state: State,
    targets: Targets,
    shape_prior: ShapePrior,
    limits: Tensor | None = None,
    limit_sigma: float = RefinementConfig.limit_sigma,
) -> Linearisation:
    """Residuals (B, R) and their derivative (B, R, P): keypoints first, three each, then beta, then ``limits``
    (B, J, 2) where given. Residuals are differentiable in the targets' keypoints."""
    points, by_points = keypoint_jacobian(prior, state)
    root, L = targets.weights.sqrt(), shape_prior.whitening.to(points)
    off = (root[..., None] * (points - targets.keypoints)).flatten(1)
    residuals = [off, (state.beta - shape_prior.mean.to(points)) @ L.mT]
    by_beta = pad(L, (6 + prior.tree.num_joints, 0)).expand(len(points), -1, -1)
    rows = [(root[..., None, None] * by_points).flatten(1, 2), by_beta]
    if limits is not None:
        low, high = limits.unbind(-1)
        outside = (state.joint_states - high).clamp(min=0) + (state.joint_states - low).clamp(max=0)
        residuals.append(outside / limit_sigma)
        rows.append(pad(torch.diag_embed((outside != 0).to(points) / limit_sigma), (6, prior.basis_size)))
    return Linearisation(torch.cat(residuals, -1), torch.cat(rows, 1))


def energy(prior: OmadPrior, state: State, targets: Targets) -> Tensor:
    """Sum of weighted squared keypoint distances (B,), without prior and limits."""
    points = prior.deform(state.beta, state.joint_states, state.T_camera_base)
    return (targets.weights * (points - targets.keypoints).square().sum(-1)).sum(-1)
