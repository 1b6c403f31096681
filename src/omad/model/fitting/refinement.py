"""The optimisation-based estimator: fit beta, joint states and base pose to keypoint targets (paper, Eq. 9).

``energy`` says what is minimised. ``Refiner`` minimises it with one of two solvers that walk the same iterations: the
plain one in torch, batched, on any device, and the fused one (``kernel``), which does the same arithmetic one
observation at a time on the CPU without a tensor operation.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
from torch import Tensor

from omad.common.arrays import as_doubles
from omad.common.errors import InputError
from omad.geometry.least_squares import Huber, Linearisation, minimise
from omad.geometry.transforms import fit_transform

from ..prior import OmadPrior
from .energy import RefinementConfig, ShapePrior, linearise
from .state import Refined, State, Targets, covariance_of

DEFAULT_CONFIG = RefinementConfig()


def free_directions(
    num_joints: int,
    basis_size: int,
    hold_beta: bool = False,
    hold_states: bool | Sequence[bool] = False,
    gravity: Sequence[float] | np.ndarray | None = None,
) -> Tensor:
    """Columns (P, F) that the solution may move along, float64. Held unknowns keep their initial values to the last
    bit; ``hold_states`` may say so joint by joint. With ``gravity`` (its direction in the camera frame) the base only
    turns about it, so that an initial pose with a true vertical keeps it."""
    eye = torch.eye(6 + num_joints + basis_size, dtype=torch.float64)
    rotation, translation = eye[:, :3], eye[:, 3:6]
    if gravity is not None:
        vertical = torch.tensor(gravity, dtype=torch.float64)
        rotation = rotation @ (vertical / vertical.norm())[:, None]
    held = [hold_states] * num_joints if isinstance(hold_states, bool) else list(hold_states)
    if len(held) != num_joints:
        raise InputError(f"hold_states: {len(held)} values for {num_joints} joints, give one value for each")
    unheld = ~torch.tensor([*held, *[hold_beta] * basis_size])
    return torch.cat([rotation, translation, eye[:, 6:][:, unheld]], 1)


@dataclass(frozen=True)
class PlainSolver:
    """Levenberg-Marquardt on the linearised energy in torch, batched, on any device and in any float dtype."""

    prior: OmadPrior
    free: Tensor
    """(P, F) directions that the solution may move along."""
    config: RefinementConfig
    shape_prior: ShapePrior

    def fitted_poses(self, targets: Targets, state: State) -> Tensor:
        """(B, 4, 4) of the base where the keypoints are nearest to the targets."""
        at_origin = torch.eye(4).to(state.beta).expand(len(state.beta), 4, 4)
        keypoints = self.prior.deform(state.beta, state.joint_states, at_origin)
        return fit_transform(keypoints, _counted(targets), targets.weights)

    def __call__(self, targets: Targets, initial: State, limits: Tensor) -> Refined:
        """From ``initial``; ``limits`` (B, J, 2)."""
        prior, config, joints = self.prior, self.config, self.prior.tree.num_joints
        free = self.free.to(targets.keypoints)
        seen = _counted(targets)

        def at(x: Tensor, index: Tensor) -> Linearisation:
            own = Targets(seen[index], targets.weights[index])
            found = linearise(prior, State.unpack(x, joints), own, self.shape_prior, limits[index], config.limit_sigma)
            return Linearisation(found.residuals, found.jacobian @ free)

        def retract(x: Tensor, step: Tensor, index: Tensor) -> Tensor:
            return State.unpack(x, joints).moved(step @ free.T).pack()

        robust = None if config.huber is None else Huber(config.huber, prior.num_keypoints)
        found = minimise(at, initial.pack(), retract, config.trust_region, config.termination, robust, far=False)
        state = State.unpack(found.x, joints)
        points = prior.deform(state.beta, state.joint_states, state.T_camera_base)
        covariance = covariance_of(found.hessian.double(), self.free).to(free)
        return Refined.of(state, points, targets, covariance, found.converged, found.iterations)


def _counted(targets: Targets) -> Tensor:
    """(B, N, 3) keypoints, with zeros for those left out, which may be anything."""
    return torch.where((targets.weights == 0)[..., None], 0.0, targets.keypoints)


class Refiner:
    """A prior's refinement with its constants worked out once, so that a call costs little more than its arithmetic.
    ``limits`` (B, J, 2) or (J, 2); ``free`` (P, F) from ``free_directions``, default: all. Raises InputError for limits
    of another shape."""

    def __init__(
        self, prior: OmadPrior, limits: Tensor, config: RefinementConfig = DEFAULT_CONFIG, free: Tensor | None = None
    ) -> None:
        joints, like = prior.tree.num_joints, prior.learned_basis
        if limits.dim() not in (2, 3) or limits.shape[-2:] != (joints, 2):
            raise InputError(f"limits: shape {tuple(limits.shape)}, give (J, 2) or (B, J, 2) with J = {joints}")
        free = free_directions(joints, prior.basis_size) if free is None else free
        self.prior, self.config, self.limits = prior, config, limits.to(like)
        self._sizes, self._dtype = (prior.num_keypoints, joints, prior.basis_size), like.dtype
        shape_prior = ShapePrior.of(prior.beta_mean, prior.beta_covariance, config.prior_weight)
        free = free.to(like.device, torch.float64)
        if config.backend == "kernel" or (config.backend == "auto" and like.device.type == "cpu"):
            from .kernel.prior import kernel_prior  # compiled only where it is used
            from .kernel.solve import KernelSolver

            self._solver = KernelSolver(kernel_prior(prior), as_doubles(free), config, shape_prior)
        else:
            self._solver = PlainSolver(prior, free, config, shape_prior)

    def with_shape_prior(self, mean: Tensor, covariance: Tensor) -> Self:
        """The same refinement with another Gaussian on beta, mean (D,) and covariance (D, D), than the category's."""
        other = copy(self)
        shape_prior = ShapePrior.of(mean, covariance, self.config.prior_weight)
        other._solver = replace(self._solver, shape_prior=shape_prior)
        return other

    @torch.no_grad()
    def with_fitted_pose(self, targets: Targets, state: State) -> State:
        """The state with its base where the keypoints, as the rest of it says, are nearest to the targets."""
        return replace(state, T_camera_base=self._solver.fitted_poses(targets, state))

    @torch.no_grad()
    def __call__(self, targets: Targets, initial: State) -> Refined:
        """Minimise the energy from ``initial``. A problem with NaNs comes back unconverged with its initial values, and
        changes no other. Raises InputError for tensors of the wrong shape and for negative weights."""
        batch, (keypoints, joints, beta) = len(targets.keypoints), self._sizes
        for name, tensor, wanted in (
            ("targets.keypoints", targets.keypoints, (batch, keypoints, 3)),
            ("targets.weights", targets.weights, (batch, keypoints)),
            ("initial.beta", initial.beta, (batch, beta)),
            ("initial.joint_states", initial.joint_states, (batch, joints)),
            ("initial.T_camera_base", initial.T_camera_base, (batch, 4, 4)),
        ):
            if tensor.shape != wanted:
                raise InputError(f"{name}: shape {tuple(tensor.shape)}, this prior and batch need {wanted}")
            if tensor.dtype != self._dtype:
                raise InputError(f"{name}: {tensor.dtype}, but the prior is {self._dtype}; convert one")
        if self.limits.dim() == 3 and len(self.limits) not in (1, batch):
            given = len(self.limits)
            raise InputError(f"limits: for {given} observations, there are {batch}; give (J, 2) for all of them")
        if (targets.weights < 0).any():
            raise InputError("targets.weights: negative, give 1 / sigma^2 or 0 to leave a keypoint out")
        return self._solver(targets, initial, self.limits.expand(batch, -1, -1))
