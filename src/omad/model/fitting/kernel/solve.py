"""Fused refinement on the CPU: the whole Levenberg-Marquardt of one observation in compiled loops, float64.

Same energy, derivatives, damping and stopping rules, from the same settings, as the plain torch version (the tests
hold the two together, iteration by iteration); there the time goes to launching tensor operations, here there are
none.

Keypoints M, joints J, |beta| D, unknowns P = 6 + J + D as in ``state``, free directions F. A point of the search is one
row x of 16 + J + D numbers, as ``State.pack`` has them.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from omad.common.arrays import as_doubles
from omad.common.compiled import inner, jit

from ..energy import RefinementConfig, ShapePrior
from ..state import Refined, State, Targets
from .algebra import invert, rotation, solve_damped
from .evaluate import KernelProblem, differentiate, evaluate
from .prior import KernelPrior, buffers, place_bases

EPSILON = 2.220446049250313e-16


@inner
def _project(free, gradient, hessian, work, g, A):
    """Gradient and hessian over the free directions: g (F,), A (F, F); work (F, P)."""
    P, F = free.shape
    for f in range(F):
        g[f] = 0.0
        for a in range(P):
            work[f, a] = 0.0
        for b in range(P):
            if free[b, f] != 0.0:
                g[f] += free[b, f] * gradient[b]
                for a in range(P):
                    work[f, a] += free[b, f] * hessian[b, a]
    for e in range(F):
        for f in range(F):
            A[e, f] = 0.0
        for a in range(P):
            if free[a, e] != 0.0:
                for f in range(F):
                    A[e, f] += free[a, e] * work[f, a]


@inner
def _unproject(free, inverse, work, out):
    """``free @ inverse @ free.T``: (P, P) of (F, F); work (F, P)."""
    P, F = free.shape
    for b in range(P):
        for e in range(F):
            work[e, b] = 0.0
        for f in range(F):
            if free[b, f] != 0.0:
                for e in range(F):
                    work[e, b] += free[b, f] * inverse[e, f]
    for a in range(P):
        for b in range(P):
            out[a, b] = 0.0
        for e in range(F):
            if free[a, e] != 0.0:
                for b in range(P):
                    out[a, b] += free[a, e] * work[e, b]


@inner
def _retract(free, x, step, turn, out):
    """Move x by ``step`` (F,) along the free directions, into ``out``; what no direction reaches keeps its bits."""
    P, F = free.shape
    omega = np.zeros(3)
    for a in range(P):
        move = 0.0
        for f in range(F):
            move += free[a, f] * step[f]
        if a < 3:
            omega[a] = move
        elif a < 6:
            out[4 * a - 9] = x[4 * a - 9] + move
        else:
            out[10 + a] = x[10 + a] + move
    squared = omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2
    if squared < 1e-8:
        rotation(omega, 1.0 - squared / 6.0, 0.5 - squared / 24.0, turn)
    else:
        angle = math.sqrt(squared)
        rotation(omega, math.sin(angle) / angle, (1.0 - math.cos(angle)) / squared, turn)
    for i in range(3):
        for n in range(3):
            out[4 * i + n] = turn[i, 0] * x[n] + turn[i, 1] * x[4 + n] + turn[i, 2] * x[8 + n]


@jit
def _minimise_all(
    c, targets, weights, limits, points, covariances, energies, residuals, converged, iterations,
    initial_damping, max_damping, diagonal_floor, most, smallest, share,
):  # fmt: skip
    """Rows of ``points`` are moved in place; ``covariances`` (B, P, P) receive those of the unknowns, ``energies`` and
    ``residuals`` (B,) how far keypoints are from their targets."""
    P, F = c.free.shape
    M = weights.shape[1]
    at, root, off, squared = buffers(c.prior), np.empty(M), np.empty((3, M)), np.empty(M)
    gradient, hessian, work, turn = np.empty(P), np.empty((P, P)), np.empty((F, P)), np.empty((3, 3))
    g, step, extra, A = np.empty(F), np.empty(F), np.empty(F), np.empty((F, F))
    L, inverse, trial = np.empty((F, F)), np.empty((F, F)), np.empty(points.shape[1])
    for o in range(len(points)):
        x = points[o]
        cost = evaluate(c, x, targets[o], weights[o], limits[o], at, root, off)
        _square(off, squared)
        differentiate(c, x, limits[o], at, root, off, gradient, hessian)
        _project(c.free, gradient, hessian, work, g, A)
        damping, growth = initial_damping, 2.0
        trial[:] = x
        while math.isfinite(cost) and iterations[o] < most and damping <= max_damping and not converged[o]:
            iterations[o] += 1
            largest = 0.0
            for f in range(F):
                largest = max(largest, A[f, f])
            for f in range(F):
                scale = max(A[f, f], diagonal_floor * largest)
                extra[f] = damping * (scale if scale > 0.0 else 1.0)
            # see least_squares.minimise for why the damping follows the gain ratio
            accepted = False
            if solve_damped(A, extra, g, L, step):
                _retract(c.free, x, step, turn, trial)
                new_cost = evaluate(c, trial, targets[o], weights[o], limits[o], at, root, off)
                gained, promised, longest = cost - new_cost, 0.0, 0.0
                for f in range(F):
                    promised += step[f] * (extra[f] * step[f] - g[f])
                    longest = max(longest, abs(step[f]))
                accepted = gained > 0.0
                if accepted:
                    converged[o] = longest < smallest or gained < share * cost
                    damping *= max(1.0 - (2.0 * gained / promised - 1.0) ** 3, 1.0 / 3.0)
                    growth = 2.0
                    cost = new_cost
                    x[:] = trial
                    _square(off, squared)
                    differentiate(c, x, limits[o], at, root, off, gradient, hessian)
                    _project(c.free, gradient, hessian, work, g, A)
                else:
                    # rounding may hide the last decrease
                    converged[o] = promised <= 8.0 * EPSILON * cost or (longest < smallest and damping <= 1.0)
            if not accepted:
                damping *= growth
                growth *= 2.0
        energies[o], residuals[o] = _distances(weights[o], squared)
        if math.isfinite(cost) and invert(A, L, extra, step, inverse):
            _unproject(c.free, inverse, work, covariances[o])
        else:
            covariances[o] = math.nan


@inner
def _square(off, squared):
    """Lengths (M,) of the columns of ``off`` (3, M), squared."""
    for m in range(len(squared)):
        squared[m] = off[0, m] ** 2 + off[1, m] ** 2 + off[2, m] ** 2


@inner
def _distances(weights, squared):
    """Weighted sum of squared keypoint distances (M,), and their RMS where they count."""
    energy, total, count = 0.0, 0.0, 0
    for m in range(len(weights)):
        energy += weights[m] * squared[m]
        total += squared[m]
        count += weights[m] != 0.0
    return energy, math.sqrt(total / max(count, 1))


@dataclass(frozen=True)
class KernelSolver:
    """The fused version of ``refinement.PlainSolver``: same call, same iterations."""

    prior: KernelPrior
    free: np.ndarray
    """(P, F)."""
    config: RefinementConfig
    shape_prior: ShapePrior

    @cached_property
    def problem(self) -> KernelProblem:
        """What all calls have in common."""
        config, mean, whitening = self.config, self.shape_prior.mean, self.shape_prior.whitening
        huber = math.inf if config.huber is None else config.huber
        arrays = as_doubles(mean), as_doubles(whitening), self.free
        return KernelProblem(self.prior, *arrays, 1 / config.limit_sigma, huber)

    def fitted_poses(self, targets: Targets, state: State) -> Tensor:
        """(B, 4, 4) of the base where the keypoints are nearest to the targets."""
        rows = as_doubles(state.pack())
        place_bases(self.prior, as_doubles(targets.keypoints), as_doubles(targets.weights), rows)
        return torch.from_numpy(rows[:, :16].reshape(-1, 4, 4)).to(state.beta)

    def __call__(self, targets: Targets, initial: State, limits: Tensor) -> Refined:
        """From ``initial``; ``limits`` (B, J, 2)."""
        batch, unknowns, trust, end = (
            len(initial.beta),
            len(self.free),
            self.config.trust_region,
            self.config.termination,
        )
        rows, covariance = as_doubles(initial.pack()), np.empty((batch, unknowns, unknowns))
        energy, residual = np.empty(batch), np.empty(batch)
        converged, iterations = np.zeros(batch, dtype=np.bool_), np.zeros(batch, dtype=np.int64)
        _minimise_all(
            self.problem, as_doubles(targets.keypoints), as_doubles(targets.weights), as_doubles(limits),
            rows, covariance, energy, residual, converged, iterations,
            trust.initial_damping, trust.max_damping, trust.diagonal_floor,
            end.max_iterations, end.step_tolerance, end.cost_tolerance,
        )  # fmt: skip
        like = targets.keypoints
        found, covariance, energy, residual = (
            torch.from_numpy(array).to(like) for array in (rows, covariance, energy, residual)
        )
        done, steps = (torch.from_numpy(array).to(like.device) for array in (converged, iterations))
        state = State.unpack(found, initial.joint_states.shape[1])
        return Refined(state, covariance, done, steps, energy, residual)
