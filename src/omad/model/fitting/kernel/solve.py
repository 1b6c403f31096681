"""Fused refinement on the CPU: the whole Levenberg-Marquardt of one observation in compiled loops, float64.

Same energy, derivatives, damping and stopping rules, from the same settings, as the plain torch version (the tests
hold the two together, iteration by iteration); there the time goes to launching tensor operations, here there are
none. Explicit loops rather than array expressions, because those take several times longer to compile; compiled code
is kept on disk.

Keypoints M, joints J, |beta| D, hidden units H, unknowns P = 6 + J + D as in ``state``, free directions F.
A point of the search is one row x of 12 + J + D numbers: base rotation row by row, translation, joint states, beta.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from omad.common.arrays import as_doubles

from ..energy import RefinementConfig, ShapePrior
from ..state import Refined, State, Targets
from .algebra import add_skew, cross, inner, jit, rotation, solve_damped, times
from .prior import KernelPrior, joint_function, place_bases, place_parts

EPSILON = 2.220446049250313e-16


class KernelProblem(NamedTuple):
    """Constants of a refinement, as arrays."""

    prior: KernelPrior
    beta_mean: np.ndarray  # (D,)
    whitening: np.ndarray  # (D, D)
    free: np.ndarray  # (P, F)
    limit_weight: float
    huber: float  # infinity: plain squares


@inner
def _evaluate(c, x, targets, weights, limits, gradient, hessian, squared):
    """The energy at x; J^T r (P,), the lower triangle of J^T J (P, P) and each keypoint's squared distance (M,) are
    overwritten, the latter where it counts."""
    prior = c.prior
    M, _, D = prior.basis.shape
    J = len(prior.parents)
    S, B, P = 6, 6 + J, 6 + J + D  # where joint states and beta begin
    states, beta = x[12 : 12 + J], x[12 + J :]
    axes, pivots = np.empty((J, 3)), np.empty((J, 3))
    d_axes, d_pivots = np.empty((J, 3, D)), np.empty((J, 3, D))
    joint_function(prior, beta, axes, pivots, d_axes, d_pivots)

    # With R the rotation of the parent and R' of the child, a point below the joint moves by K (R du) + (R - R') dq;
    # both brackets are made here.
    G, g = np.empty((J + 1, 3, 3)), np.empty((J + 1, 3))
    lines, centres, v = np.empty((J, 3)), np.empty((J, 3)), np.empty(3)
    by_axis, by_pivot = np.zeros((J, 3, D)), np.zeros((J, 3, D))
    place_parts(prior, x, axes, pivots, G, g, lines, centres)
    for j in range(J):
        R, child = G[prior.parents[j]], G[j + 1]
        for i in range(3):
            for n in range(3):
                lever = R[i, n] - child[i, n]
                for d in range(D):
                    by_axis[j, i, d] += R[i, n] * d_axes[j, n, d]
                    by_pivot[j, i, d] += lever * d_pivots[j, n, d]

    for a in range(P):
        gradient[a] = 0.0
        for b in range(P):
            hessian[a, b] = 0.0
    cost = 0.0
    rows, K = np.empty((3, P)), np.empty((3, 3))
    point, arm, off = np.empty(3), np.empty(3), np.empty(3)
    for m in range(M):
        if weights[m] == 0.0:
            continue
        part = prior.part_of[m]
        for i in range(3):
            v[i] = 0.0
            for d in range(D):
                v[i] += prior.basis[m, i, d] * beta[d]
            for a in range(P):
                rows[i, a] = 0.0
            rows[i, 3 + i] = 1.0
        times(G[part], v, point)
        for i in range(3):
            point[i] += g[part, i]
            off[i] = point[i] - targets[m, i]
            arm[i] = g[0, i] - point[i]
            for n in range(3):
                for d in range(D):
                    rows[i, B + d] += G[part, i, n] * prior.basis[m, n, d]
        add_skew(1.0, arm, rows)
        while part > 0:  # every joint between the keypoint and the root
            j = part - 1
            part = prior.parents[j]
            u = lines[j]
            turn, slide = prior.turn[j], prior.slide[j]
            s, k = math.sin(turn * states[j]), 1.0 - math.cos(turn * states[j])
            for i in range(3):
                arm[i] = point[i] - centres[j, i] - slide * states[j] * u[i]
            cross(u, arm, v)
            along = u[0] * arm[0] + u[1] * arm[1] + u[2] * arm[2]
            for i in range(3):
                rows[i, S + j] = turn * v[i] + slide * u[i]
                arm[i] += k * (along * u[i] - arm[i]) - s * v[i]  # as it was before the joint turned it
            for i in range(3):
                for n in range(3):
                    K[i, n] = k * u[i] * arm[n]
                K[i, i] += k * along + slide * states[j]
            add_skew(-s, arm, K)
            for i in range(3):
                for d in range(D):
                    rows[i, B + d] += by_pivot[j, i, d]
                for n in range(3):
                    for d in range(D):
                        rows[i, B + d] += K[i, n] * by_axis[j, n, d]
        w = weights[m]
        squared[m] = off[0] ** 2 + off[1] ** 2 + off[2] ** 2
        term = w * squared[m]
        if term > c.huber**2:
            length = math.sqrt(term)
            w *= c.huber / length
            term = c.huber * (2.0 * length - c.huber)
        cost += term
        for i in range(3):
            for a in range(P):
                scaled = w * rows[i, a]
                gradient[a] += scaled * off[i]
                for b in range(a + 1):
                    hessian[a, b] += scaled * rows[i, b]

    for i in range(D):  # c.whitening is upper triangular
        white = 0.0
        for d in range(i, D):
            white += c.whitening[i, d] * (beta[d] - c.beta_mean[d])
        cost += white * white
        for a in range(i, D):
            gradient[B + a] += c.whitening[i, a] * white
            for b in range(i, a + 1):
                hessian[B + a, B + b] += c.whitening[i, a] * c.whitening[i, b]
    for j in range(J):
        outside = max(states[j] - limits[j, 1], 0.0) + min(states[j] - limits[j, 0], 0.0)
        if outside != 0.0:
            weight = c.limit_weight**2
            cost += weight * outside**2
            gradient[S + j] += weight * outside
            hessian[S + j, S + j] += weight
    return cost


@inner
def _project(free, gradient, hessian, work, g, A):
    """Gradient and (from its lower triangle) hessian over the free directions: g (F,), A (F, F); work (P, F)."""
    P, F = free.shape
    for a in range(P):
        for f in range(F):
            work[a, f] = 0.0
        for b in range(P):
            value = hessian[a, b] if b <= a else hessian[b, a]
            for f in range(F):
                work[a, f] += value * free[b, f]
    for e in range(F):
        g[e] = 0.0
        for f in range(F):
            A[e, f] = 0.0
        for a in range(P):
            if free[a, e] != 0.0:
                g[e] += free[a, e] * gradient[a]
                for f in range(F):
                    A[e, f] += free[a, e] * work[a, f]


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
        else:
            out[6 + a] = x[6 + a] + move
    squared = omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2
    if squared < 1e-8:
        rotation(omega, 1.0 - squared / 6.0, 0.5 - squared / 24.0, turn)
    else:
        angle = math.sqrt(squared)
        rotation(omega, math.sin(angle) / angle, (1.0 - math.cos(angle)) / squared, turn)
    for i in range(3):
        for n in range(3):
            out[3 * i + n] = turn[i, 0] * x[n] + turn[i, 1] * x[3 + n] + turn[i, 2] * x[6 + n]


@jit
def _minimise_all(
    c, targets, weights, limits, points, hessians, squared, converged, iterations,
    initial_damping, max_damping, diagonal_floor, most, smallest, share,
):  # fmt: skip
    """Rows of ``points`` are moved in place; ``hessians`` receive J^T J over the free directions, ``squared`` how far
    keypoints are from their targets."""
    P, F = c.free.shape
    gradient, hessian, work, turn = np.empty(P), np.empty((P, P)), np.empty((P, F)), np.empty((3, 3))
    g, step, extra = np.empty(F), np.empty(F), np.empty(F)
    L, trial, trial_squared = np.empty((F, F)), np.empty(points.shape[1]), np.zeros(squared.shape[1])
    for o in range(len(points)):
        x, A = points[o], hessians[o]
        cost = _evaluate(c, x, targets[o], weights[o], limits[o], gradient, hessian, squared[o])
        _project(c.free, gradient, hessian, work, g, A)
        damping, growth = initial_damping, 2.0
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
                new_cost = _evaluate(c, trial, targets[o], weights[o], limits[o], gradient, hessian, trial_squared)
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
                    _project(c.free, gradient, hessian, work, g, A)
                    for a in range(len(x)):
                        x[a] = trial[a]
                    for m in range(len(trial_squared)):
                        squared[o, m] = trial_squared[m]
                else:
                    # rounding may hide the last decrease
                    converged[o] = promised <= 8.0 * EPSILON * cost or (longest < smallest and damping <= 1.0)
            if not accepted:
                damping *= growth
                growth *= 2.0


@dataclass(frozen=True)
class KernelSolver:
    """The fused version of ``refinement.PlainSolver``: same call, same iterations."""

    prior: KernelPrior
    free: Tensor
    """(P, F)."""
    config: RefinementConfig

    def fitted_poses(self, targets: Targets, state: State) -> Tensor:
        """(B, 4, 4) of the base where the keypoints are nearest to the targets."""
        rest = [as_doubles(state.joint_states), as_doubles(state.beta)]
        rows = np.concatenate([np.empty((len(state.beta), 12)), *rest], 1)
        place_bases(self.prior, as_doubles(targets.keypoints), as_doubles(targets.weights), rows)
        return torch.as_tensor(_poses(rows)).to(state.beta)

    def __call__(self, targets: Targets, initial: State, limits: Tensor, shape_prior: ShapePrior) -> Refined:
        """From ``initial``; ``limits`` (B, J, 2)."""
        config, mean, whitening = self.config, as_doubles(shape_prior.mean), as_doubles(shape_prior.whitening)
        huber = math.inf if config.huber is None else config.huber
        problem = KernelProblem(self.prior, mean, whitening, as_doubles(self.free), 1 / config.limit_sigma, huber)
        poses, batch, joints = as_doubles(initial.T_camera_base), len(initial.beta), initial.joint_states.shape[1]
        unknowns = [as_doubles(initial.joint_states), as_doubles(initial.beta)]
        rows = np.concatenate([poses[:, :3, :3].reshape(batch, 9), poses[:, :3, 3], *unknowns], 1)
        observed = as_doubles(targets.keypoints), as_doubles(targets.weights), as_doubles(limits)
        hessian = np.empty((batch, self.free.shape[1], self.free.shape[1]))
        squared = np.zeros(targets.weights.shape)
        converged, iterations = np.zeros(batch, dtype=np.bool_), np.zeros(batch, dtype=np.int64)
        trust, end = config.trust_region, config.termination
        _minimise_all(
            problem, *observed, rows, hessian, squared, converged, iterations,
            trust.initial_damping, trust.max_damping, trust.diagonal_floor,
            end.max_iterations, end.step_tolerance, end.cost_tolerance,
        )  # fmt: skip
        like, found = targets.keypoints, (rows[:, 12 + joints :], rows[:, 12 : 12 + joints], _poses(rows), squared)
        *state, apart = (torch.as_tensor(array).to(like) for array in found)
        A, done, steps = (torch.as_tensor(array, device=like.device) for array in (hessian, converged, iterations))
        return Refined(State(*state), A, self.free, done, steps, targets.weights, apart)


def _poses(rows: np.ndarray) -> np.ndarray:
    poses = np.zeros((len(rows), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:12], 1.0
    return poses
