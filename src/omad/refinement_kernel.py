"""Fused refinement on the CPU: the whole Levenberg-Marquardt of one observation in compiled loops, float64.

Same energy, derivatives, damping and stopping rules as the plain torch version in ``refinement`` (the tests compare
them); there the time goes to launching tensor operations, here there are none. Explicit loops rather than array
expressions, because those take several times longer to compile; compiled code is kept on disk.

Keypoints M, joints J, |beta| D, hidden units H, unknowns P = 6 + J + D as in ``refinement``, free directions F.
A point of the search is one row x of 12 + J + D numbers: base rotation row by row, translation, joint states, beta.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from torch import Tensor

from .arrays import as_doubles
from .least_squares import TerminationConfig
from .prior import OmadPrior
from .prior_kernel import KernelPrior, joint_function, kernel_prior, place_bases, place_parts
from .small_matrices import add_skew, cross, inner, jit, rotation, solve_damped, times

EPSILON = 2.220446049250313e-16


class KernelProblem(NamedTuple):
    """Constants of a refinement, as arrays."""

    prior: KernelPrior
    beta_mean: np.ndarray  # (D,)
    whitening: np.ndarray  # (D, D)
    free: np.ndarray  # (P, F)
    limit_weight: float
    huber: float  # infinity: plain squares


class KernelSolution(NamedTuple):
    """What became of B observations."""

    beta: np.ndarray  # (B, D)
    joint_states: np.ndarray  # (B, J)
    T_camera_base: np.ndarray  # (B, 4, 4)
    hessian: np.ndarray  # (B, F, F) J^T J over the free directions
    squared: np.ndarray  # (B, M) squared distances of keypoints from their targets; 0 where the weight is
    converged: np.ndarray  # (B,) bool
    iterations: np.ndarray  # (B,)


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
            for i in range(3):
                for n in range(3):
                    K[i, n] = 0.0
            if prior.revolute[j]:
                for i in range(3):
                    arm[i] = point[i] - centres[j, i]
                cross(u, arm, v)
                s, k = math.sin(states[j]), 1.0 - math.cos(states[j])
                along = u[0] * arm[0] + u[1] * arm[1] + u[2] * arm[2]
                for i in range(3):
                    rows[i, S + j] = v[i]
                    arm[i] += k * (along * u[i] - arm[i]) - s * v[i]  # as it was before the joint turned it
                for i in range(3):
                    for n in range(3):
                        K[i, n] = k * u[i] * arm[n]
                    K[i, i] += k * along
                add_skew(-s, arm, K)
            else:
                for i in range(3):
                    rows[i, S + j] = u[i]
                    K[i, i] = states[j]
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
def _minimise_all(c, targets, weights, limits, points, hessians, squared, converged, iterations, most, smallest, share):
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
        damping, growth = 1e-3, 2.0
        while math.isfinite(cost) and iterations[o] < most and damping <= 1e12 and not converged[o]:
            iterations[o] += 1
            largest = 0.0
            for f in range(F):
                largest = max(largest, A[f, f])
            for f in range(F):
                scale = max(A[f, f], 1e-9 * largest)
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


def prepare(
    prior: OmadPrior, whitening: Tensor, free: Tensor, limit_sigma: float, huber: float | None
) -> KernelProblem:
    """The prior and the energy's constants as float64 arrays; see ``refinement`` for their meaning."""
    return KernelProblem(
        prior=kernel_prior(prior),
        beta_mean=as_doubles(prior.beta_mean),
        whitening=as_doubles(whitening),
        free=as_doubles(free),
        limit_weight=1 / limit_sigma,
        huber=math.inf if huber is None else huber,
    )


def place(problem: KernelProblem, targets: np.ndarray, weights: np.ndarray, states: np.ndarray, beta: np.ndarray):
    """Base poses (B, 4, 4) where keypoints of states (B, J) and beta (B, D) are nearest to targets (B, M, 3)."""
    rows = np.concatenate([np.empty((len(beta), 12)), states, beta], 1)
    place_bases(problem.prior, targets, weights, rows)
    return _poses(rows)


def _poses(rows: np.ndarray) -> np.ndarray:
    poses = np.zeros((len(rows), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:12], 1.0
    return poses


def solve(
    problem: KernelProblem,
    targets: np.ndarray,
    weights: np.ndarray,
    limits: np.ndarray,
    poses: np.ndarray,
    states: np.ndarray,
    beta: np.ndarray,
    termination: TerminationConfig,
) -> KernelSolution:
    """Solve every observation, float64 arrays: targets (B, M, 3), weights (B, M), limits (B, J, 2) and the starting
    values poses (B, 4, 4), states (B, J), beta (B, D)."""
    batch, directions = len(poses), problem.free.shape[1]
    points = np.concatenate([poses[:, :3, :3].reshape(batch, 9), poses[:, :3, 3], states, beta], 1)
    hessian = np.empty((batch, directions, directions))
    squared = np.zeros(weights.shape)
    converged, iterations = np.zeros(batch, dtype=np.bool_), np.zeros(batch, dtype=np.int64)
    _minimise_all(
        problem, targets, weights, limits, points, hessian, squared, converged, iterations,
        termination.max_iterations, termination.step_tolerance, termination.cost_tolerance,
    )  # fmt: skip
    joints = states.shape[1]
    states, beta = points[:, 12 : 12 + joints], points[:, 12 + joints :]
    return KernelSolution(beta, states, _poses(points), hessian, squared, converged, iterations)
