"""The optimisation-based estimator: fit beta, joint states and base pose to keypoint targets (paper, Eq. 9).

Per observation, over the unknowns, in this order

    omega (3)  rotation of the base, R <- exp(omega) R, tangent of SO(3) in camera axes
    t (3)      translation of the base
    theta (J)  joint states
    beta (D)   shape parameters

it minimises   sum_i w_i |W(S(beta), J(beta), Theta)_i - target_i|^2      (robustified)
             + prior_weight * (beta - mean)^T covariance^-1 (beta - mean)
             + soft joint limits.

Category units and radians. P = 6 + J + D. The plain version is in torch, batched, on any device; the fused one
(``refinement_kernel``) does the same arithmetic one observation at a time without a tensor operation.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from .arrays import as_doubles
from .errors import InputError
from .geometry import fit_transform, make_transform, so3_exp
from .keypoint_jacobian import State, keypoint_jacobian
from .least_squares import Linearisation, RobustKernel, TerminationConfig, minimise
from .prior import OmadPrior

if TYPE_CHECKING:
    from .refinement_kernel import KernelProblem


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
    step_tolerance: float = 1e-7
    cost_tolerance: float = 1e-10
    """See ``least_squares.TerminationConfig``."""
    backend: Literal["auto", "torch", "kernel"] = "auto"
    """'auto': the fused kernel (always float64) on the CPU, torch (in the dtype of the targets) elsewhere."""

    @property
    def termination(self) -> TerminationConfig:
        return TerminationConfig(self.max_iterations, self.step_tolerance, self.cost_tolerance)


@dataclass(frozen=True)
class Targets:
    """Where the keypoints of B observations are seen."""

    keypoints: Tensor
    """(B, M, 3) camera frame."""
    weights: Tensor
    """(B, M) 1 / sigma^2 of each; 0 leaves one out, whatever its coordinates."""


@dataclass(frozen=True)
class Refined:
    """What became of B observations."""

    state: State
    hessian: Tensor
    """(B, F, F) J^T J over the free directions, float64."""
    directions: Tensor
    """(P, F) which those are, float64."""
    converged: Tensor
    """(B,) bool."""
    iterations: Tensor
    """(B,) int64."""
    weights: Tensor
    """(B, M) of the targets."""
    squared: Tensor
    """(B, M) squared distance of each keypoint from its target; arbitrary where the weight is 0."""

    @property
    def energy(self) -> Tensor:
        """(B,) sum of weighted squared keypoint distances."""
        return torch.where(self.weights > 0, self.weights * self.squared, 0.0).sum(-1)

    @property
    def residual(self) -> Tensor:
        """(B,) RMS keypoint distance over the keypoints with weight."""
        counts = self.weights != 0
        return (torch.where(counts, self.squared, 0.0).sum(-1) / counts.sum(-1).clamp(min=1)).sqrt()

    @cached_property
    def covariance(self) -> Tensor:
        """(B, P, P) of the unknowns in tangent coordinates (omega, t, theta, beta), from J^T J; zero for held ones."""
        return (self.directions @ _inverse(self.hessian) @ self.directions.T).to(self.weights)

    @property
    def std(self) -> Tensor:
        """(B, P) of the unknowns, in the order of ``covariance``."""
        return self.covariance.diagonal(dim1=-2, dim2=-1).sqrt()

    @property
    def rotation_std(self) -> Tensor:
        """(B, 3) radians about the camera's axes."""
        return self.std[:, :3]

    @property
    def translation_std(self) -> Tensor:
        """(B, 3)."""
        return self.std[:, 3:6]

    @property
    def joint_state_std(self) -> Tensor:
        """(B, J)."""
        return self.std[:, 6 : 6 + self.state.joint_states.shape[1]]

    @property
    def beta_std(self) -> Tensor:
        """(B, D)."""
        return self.std[:, 6 + self.state.joint_states.shape[1] :]


DEFAULT_CONFIG = RefinementConfig()


def free_directions(
    num_joints: int,
    basis_size: int,
    hold_beta: bool = False,
    hold_states: bool | Sequence[bool] = False,
    hold_rotation: bool = False,
    hold_translation: bool = False,
    gravity: tuple[float, float, float] | None = None,
) -> Tensor:
    """Columns (P, F) that the solution may move along, float64.

    Held unknowns keep their initial values to the last bit; ``hold_states`` may say so joint by joint. With
    ``gravity`` (its direction in the camera frame) the base only turns about it, so that an initial pose with a
    true vertical keeps it.
    """
    eye = torch.eye(6 + num_joints + basis_size, dtype=torch.float64)
    rotation = eye[:, :3]
    if hold_rotation:
        rotation = eye[:, :0]
    elif gravity is not None:
        vertical = torch.tensor(gravity, dtype=torch.float64)
        rotation = rotation @ (vertical / vertical.norm())[:, None]
    translation = eye[:, 3 : 3 if hold_translation else 6]
    held = [hold_states] * num_joints if isinstance(hold_states, bool) else list(hold_states)
    if len(held) != num_joints:
        raise InputError(f"hold_states: {len(held)} values for {num_joints} joints, give one value for each")
    states = eye[:, [6 + joint for joint, hold in enumerate(held) if not hold]]
    beta = eye[:, 6 + num_joints : 6 + num_joints if hold_beta else None]
    return torch.cat([rotation, translation, states, beta], 1)


def energy(prior: OmadPrior, state: State, targets: Targets) -> Tensor:
    """Sum of weighted squared keypoint distances (B,)."""
    points = prior.deform(state.beta, state.joint_states, state.T_camera_base)
    return (targets.weights * (points - targets.keypoints).square().sum(-1)).sum(-1)


class Refiner:
    """A prior's refinement with its constants worked out once, so that a call costs little more than its arithmetic.

    ``limits`` (B, J, 2) or (J, 2); ``free`` (P, F) from ``free_directions``, default: all. Raises InputError for limits
    of another shape.
    """

    def __init__(
        self, prior: OmadPrior, limits: Tensor, config: RefinementConfig = DEFAULT_CONFIG, free: Tensor | None = None
    ) -> None:
        joints = prior.tree.num_joints
        if limits.dim() not in (2, 3) or limits.shape[-2:] != (joints, 2):
            raise InputError(f"limits: shape {tuple(limits.shape)}, give (J, 2) or (B, J, 2) with J = {joints}")
        like = prior.learned_basis
        free = free_directions(joints, prior.basis_size) if free is None else free
        self.prior, self.config = prior, config
        self._sizes, self._dtype = (prior.num_keypoints, joints, prior.basis_size), like.dtype
        self.limits, self.free = limits.to(like), free.to(like.device, torch.float64)
        self.beta_mean, self.whitening = prior.beta_mean, beta_whitening(prior.beta_covariance, config.prior_weight)
        self._kernel: KernelProblem | None = None
        if config.backend == "kernel" or (config.backend == "auto" and like.device.type == "cpu"):
            from .refinement_kernel import prepare  # compiled only where it is used

            self._kernel = prepare(prior, self.whitening, self.free, config.limit_sigma, config.huber)

    def believing(self, mean: Tensor, covariance: Tensor) -> Refiner:
        """The same refinement with another Gaussian on beta, mean (D,) and covariance (D, D), than the category's."""
        other = copy(self)
        other.beta_mean, other.whitening = mean, beta_whitening(covariance, self.config.prior_weight)
        if self._kernel is not None:
            values = (tensor.detach().cpu().double().numpy() for tensor in (other.beta_mean, other.whitening))
            other._kernel = self._kernel._replace(**dict(zip(("beta_mean", "whitening"), values, strict=True)))
        return other

    @torch.no_grad()
    def placed(self, targets: Targets, state: State) -> State:
        """The state with its base where the keypoints, as the rest of it says, are nearest to the targets."""
        if self._kernel is not None:
            from .refinement_kernel import place

            arrays = (as_doubles(t) for t in (targets.keypoints, targets.weights, state.joint_states, state.beta))
            return replace(state, T_camera_base=torch.as_tensor(place(self._kernel, *arrays)).to(state.beta))
        at_origin = torch.eye(4).to(state.beta).expand(len(state.beta), 4, 4)
        keypoints = self.prior.deform(state.beta, state.joint_states, at_origin)
        return replace(state, T_camera_base=fit_transform(keypoints, targets.keypoints, targets.weights))

    @torch.no_grad()
    def __call__(self, targets: Targets, initial: State) -> Refined:
        """Minimise the energy from ``initial``.

        A problem with NaNs comes back unconverged with its initial values, and changes no other. Raises InputError for
        tensors of the wrong shape and for negative weights.
        """
        _check(self._sizes, self._dtype, targets, initial, self.limits)
        limits = self.limits.expand(len(initial.beta), -1, -1)
        if self._kernel is not None:
            return _solve_with_kernel(self._kernel, self.free, targets, initial, limits, self.config)
        left_out = (targets.weights == 0)[..., None]
        return _solve_with_torch(
            self, replace(targets, keypoints=torch.where(left_out, 0.0, targets.keypoints)), initial, limits
        )


def refine(
    prior: OmadPrior,
    targets: Targets,
    initial: State,
    limits: Tensor,
    config: RefinementConfig = DEFAULT_CONFIG,
    free: Tensor | None = None,
) -> Refined:
    """Refine once; see ``Refiner``, which is faster for many calls."""
    return Refiner(prior, limits, config, free)(targets, initial)


def _check(sizes: tuple[int, int, int], dtype: torch.dtype, targets: Targets, initial: State, limits: Tensor) -> None:
    """``sizes``: of keypoints, joints and beta."""
    batch, (keypoints, joints, beta) = len(targets.keypoints), sizes
    for name, tensor, wanted in (
        ("targets.keypoints", targets.keypoints, (batch, keypoints, 3)),
        ("targets.weights", targets.weights, (batch, keypoints)),
        ("initial.beta", initial.beta, (batch, beta)),
        ("initial.joint_states", initial.joint_states, (batch, joints)),
        ("initial.T_camera_base", initial.T_camera_base, (batch, 4, 4)),
    ):
        if tensor.shape != wanted:
            raise InputError(f"{name}: shape {tuple(tensor.shape)}, this prior and batch need {wanted}")
        if tensor.dtype != dtype:
            raise InputError(f"{name}: {tensor.dtype}, but the prior is {dtype}; convert one")
    if limits.dim() == 3 and len(limits) not in (1, batch):
        raise InputError(f"limits: for {len(limits)} observations, there are {batch}; give (J, 2) for all of them")
    if (targets.weights < 0).any():
        raise InputError("targets.weights: negative, give 1 / sigma^2 or 0 to leave a keypoint out")


def beta_whitening(covariance: Tensor, weight: float) -> Tensor:
    """(D, D) upper triangular L with |L (beta - mean)|^2 = weight * squared Mahalanobis distance, float64.

    A direction in which the training objects hardly vary counts as a thousandth of the widest one's spread, so that
    few objects, or alike ones, still make a usable prior.
    """
    spread, directions = torch.linalg.eigh(covariance.double())
    spread = spread.clamp(min=1e-6 * float(spread[-1].clamp(min=1e-12)))
    return torch.linalg.qr((weight / spread).sqrt()[:, None] * directions.mT).R


def _inverse(hessian: Tensor) -> Tensor:
    """Inverse of each J^T J in float64: very large where a direction is not observed, NaN where it is broken."""
    hessian = hessian.double()
    diagonal = hessian.diagonal(dim1=-2, dim2=-1)
    root = torch.where(diagonal > 0, diagonal, torch.where(diagonal == 0, 1e-12, torch.nan)).sqrt()
    eye = torch.eye(hessian.shape[-1], dtype=hessian.dtype, device=hessian.device)
    # Scaled to a unit diagonal, whatever the units, a singular matrix needs only this much to be invertible.
    factor, info = torch.linalg.cholesky_ex(hessian / (root[..., None] * root[..., None, :]) + 1e-12 * eye)
    bad = (info != 0)[:, None, None]
    inverse = torch.cholesky_inverse(torch.where(bad, eye, factor)) / (root[..., None] * root[..., None, :])
    return torch.where(bad, torch.nan, inverse)


def _solve_with_kernel(
    problem: KernelProblem, free: Tensor, targets: Targets, initial: State, limits: Tensor, config: RefinementConfig
) -> Refined:
    from . import refinement_kernel

    observed = as_doubles(targets.keypoints), as_doubles(targets.weights), as_doubles(limits)
    start = as_doubles(initial.T_camera_base), as_doubles(initial.joint_states), as_doubles(initial.beta)
    found = refinement_kernel.solve(problem, *observed, *start, config.termination)
    like = targets.keypoints
    state = State(*(torch.as_tensor(a).to(like) for a in (found.beta, found.joint_states, found.T_camera_base)))
    return Refined(
        state=state,
        hessian=torch.as_tensor(found.hessian, device=like.device),
        directions=free,
        converged=torch.as_tensor(found.converged, device=like.device),
        iterations=torch.as_tensor(found.iterations, device=like.device),
        weights=targets.weights,
        squared=torch.as_tensor(found.squared).to(like),
    )


def _solve_with_torch(refiner: Refiner, targets: Targets, initial: State, limits: Tensor) -> Refined:
    like, prior, config = targets.keypoints, refiner.prior, refiner.config
    joints, size = prior.tree.num_joints, prior.basis_size
    L, free, mean = refiner.whitening.to(like), refiner.free.to(like), refiner.beta_mean.to(like)
    root = targets.weights.sqrt()
    by_beta = torch.cat([like.new_zeros(size, 6 + joints), L], 1)

    def linearise(x: Tensor, index: Tensor) -> Linearisation:
        state = unpack(x)
        points, jacobian = keypoint_jacobian(prior, state)
        seen = (root[index, :, None] * (points - targets.keypoints[index])).flatten(1)
        by_seen = (root[index, :, None, None] * jacobian).flatten(1, 2)
        over = (state.joint_states - limits[index, :, 1]).clamp(min=0)
        under = (state.joint_states - limits[index, :, 0]).clamp(max=0)
        outside = ((over + under) != 0).to(like.dtype) / config.limit_sigma
        by_limits = torch.nn.functional.pad(torch.diag_embed(outside), (6, size))
        residuals = [seen, (state.beta - mean) @ L.mT, (over + under) / config.limit_sigma]
        full = torch.cat([by_seen, by_beta.expand(len(index), -1, -1), by_limits], 1)
        return Linearisation(torch.cat(residuals, -1), full @ free)

    def retract(x: Tensor, step: Tensor, index: Tensor) -> Tensor:
        state, step = unpack(x), step @ free.T
        T = state.T_camera_base
        pose = make_transform(so3_exp(step[:, :3]) @ T[:, :3, :3], T[:, :3, 3] + step[:, 3:6])
        moved = State(state.beta + step[:, 6 + joints :], state.joint_states + step[:, 6 : 6 + joints], pose)
        return pack(moved)

    def pack(state: State) -> Tensor:
        return torch.cat([state.T_camera_base.flatten(1), state.joint_states, state.beta], 1)

    def unpack(x: Tensor) -> State:
        return State(x[:, 16 + joints :], x[:, 16 : 16 + joints], x[:, :16].unflatten(1, (4, 4)))

    robust = None if config.huber is None else RobustKernel("huber", config.huber, prior.num_keypoints)
    found = minimise(linearise, pack(initial), retract, termination=config.termination, robust=robust)
    state = unpack(found.x)
    points = prior.deform(state.beta, state.joint_states, state.T_camera_base)
    squared = (points - targets.keypoints).square().sum(-1)
    hessian = found.hessian.double()
    return Refined(state, hessian, refiner.free, found.converged, found.iterations, targets.weights, squared)
