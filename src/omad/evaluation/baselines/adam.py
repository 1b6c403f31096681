"""The paper's own way to refine: Adam on quaternion, translation, joint states and beta. Kept for comparison.

Same inputs and outputs as a ``Refiner``, none of its prior, limits or covariance. Category units and radians.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from omad.geometry.transforms import make_transform, matrix_to_quaternion, quaternion_to_matrix
from omad.model.fitting.energy import energy
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import Refined, State, Targets
from omad.model.prior import OmadPrior


@dataclass(frozen=True)
class AdamConfig:
    """The authors' settings."""

    learning_rate: float = 1e-2
    max_steps: int = 3000
    check_every: int = 50
    stop_change: float = 5e-4
    """A problem stops when its loss changed by less than this (category units) since the last check."""


@dataclass(frozen=True)
class AdamResult:
    """What became of each observation."""

    state: State
    loss: Tensor
    """(B,) mean of unsquared keypoint distances, the quantity that was minimised."""
    energy: Tensor
    """(B,) sum of weighted squared keypoint distances, to compare with a ``Refiner``'s."""
    converged: Tensor
    """(B,) bool."""
    steps: Tensor
    """(B,) int64."""


DEFAULT_ADAM = AdamConfig()


def _loss(prior: OmadPrior, state: State, targets: Targets) -> Tensor:
    """(B,) mean keypoint distance, each counted by 1 / sigma relative to the others."""
    points = prior.deform(state.beta, state.joint_states, state.T_camera_base)
    squared = (points - targets.keypoints).square().sum(-1)
    distance = (squared + torch.finfo(squared.dtype).tiny).sqrt()  # finite slope where a keypoint is exactly met
    share = targets.weights.sqrt()
    return (share * distance).sum(1) / share.sum(1).clamp(min=torch.finfo(share.dtype).tiny)


def _unknowns(initial: State) -> Iterator[Tensor]:
    T = initial.T_camera_base
    for start in (matrix_to_quaternion(T[:, :3, :3]), T[:, :3, 3], initial.joint_states, initial.beta):
        yield start.detach().clone().requires_grad_()


def refine_with_adam(
    prior: OmadPrior, targets: Targets, initial: State, config: AdamConfig = DEFAULT_ADAM
) -> AdamResult:
    """Minimise the mean keypoint distance from ``initial``; every problem of a batch runs and stops as if alone."""
    quaternion, translation, states, beta = _unknowns(initial)
    optimiser = torch.optim.Adam([quaternion, translation, states, beta], lr=config.learning_rate)

    def current() -> State:
        return State(beta, states, make_transform(quaternion_to_matrix(quaternion), translation))

    result = State(initial.beta.clone(), initial.joint_states.clone(), initial.T_camera_base.clone())
    done = torch.zeros(len(beta), dtype=torch.bool, device=beta.device)
    taken = torch.zeros_like(done, dtype=torch.int64)
    previous = torch.full((len(beta),), torch.inf, dtype=beta.dtype, device=beta.device)
    for step in range(1, config.max_steps + 1):
        optimiser.zero_grad()
        loss = _loss(prior, current(), targets)
        loss.sum().backward(inputs=[quaternion, translation, states, beta])
        optimiser.step()
        if step % config.check_every and step < config.max_steps:
            continue
        with torch.no_grad():
            now = current()
            running = ~done
            result = State(
                torch.where(running[:, None], now.beta, result.beta),
                torch.where(running[:, None], now.joint_states, result.joint_states),
                torch.where(running[:, None, None], now.T_camera_base, result.T_camera_base),
            )
            taken = torch.where(running, step, taken)
            done = done | ((loss - previous).abs() < config.stop_change)
            previous = loss.detach()
            if done.all():
                break
    with torch.no_grad():
        return AdamResult(result, _loss(prior, result, targets), energy(prior, result, targets), done, taken)


def adam_refinement(refiner: Refiner, targets: Targets, initial: State) -> Refined:
    """Adam in place of an estimator's least squares: prior and limits do not count, and the covariance is NaN."""
    prior = refiner.prior
    with torch.enable_grad():
        found = refine_with_adam(prior, targets, initial)
    size = 6 + initial.joint_states.shape[1] + initial.beta.shape[1]
    unknown = torch.full((len(found.energy), size, size), torch.nan).to(found.energy)
    keypoints = prior.deform(found.state.beta, found.state.joint_states, found.state.T_camera_base)
    return Refined.of(found.state, keypoints, targets, unknown, found.converged, found.steps)
