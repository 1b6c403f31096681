"""Fused refinement on the CPU: the whole Levenberg-Marquardt of one observation in compiled loops, float64.

Same energy, derivatives and damping as the plain torch version in ``refinement`` (the tests compare them); there
the time goes to launching tensor operations, here there are none. Keypoints M, joints J, |beta| D, P = 6 + J + D.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
import torch
from torch import Tensor

from .prior import OmadPrior

_jit = numba.njit(cache=True, error_model="numpy")


class _Problem(NamedTuple):
    """Constants of a category, as arrays."""

    basis: np.ndarray  # (M, 3, D)
    part_of: np.ndarray  # (M,)
    parents: np.ndarray  # (J,)
    revolute: np.ndarray  # (J,) bool
    hidden_weight: np.ndarray  # (H, D)
    hidden_bias: np.ndarray  # (H,)
    out_weight: np.ndarray  # (6 J, H)
    out_bias: np.ndarray  # (6 J,)
    nominal_axes: np.ndarray  # (J, 3)
    beta_mean: np.ndarray  # (D,)
    whitening: np.ndarray  # (D, D)
    free: np.ndarray  # (P, F)
    limit_weight: float
    huber: float  # infinity: plain squares


@_jit
def _joints(c, beta, axes, pivots, d_axes, d_pivots, derivatives):
    """J(beta) and, where asked, its derivatives (J, 3, D)."""
    H, D = c.hidden_weight.shape
    J = len(c.parents)
    hidden = c.hidden_bias + c.hidden_weight @ beta
    for j in range(J):
        raw = np.empty(6)
        for o in range(6):
            total = c.out_bias[6 * j + o]
            for h in range(H):
                if hidden[h] > 0.0:
                    total += c.out_weight[6 * j + o, h] * hidden[h]
            raw[o] = total
        direction = c.nominal_axes[j] + raw[:3]
        length = math.sqrt((direction * direction).sum())
        axes[j] = direction / length
        for i in range(3):
            pivots[j, i] = raw[3 + i] if c.revolute[j] else 0.0
        if not derivatives:
            continue
        slope = np.zeros((6, D))
        for o in range(6):
            for h in range(H):
                if hidden[h] > 0.0:
                    weight = c.out_weight[6 * j + o, h]
                    for d in range(D):
                        slope[o, d] += weight * c.hidden_weight[h, d]
        for d in range(D):
            along = axes[j, 0] * slope[0, d] + axes[j, 1] * slope[1, d] + axes[j, 2] * slope[2, d]
            for i in range(3):
                d_axes[j, i, d] = (slope[i, d] - axes[j, i] * along) / length
                d_pivots[j, i, d] = slope[3 + i, d] if c.revolute[j] else 0.0


@_jit
def _rodrigues(u, angle):
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = u[0], u[1], u[2]
    k = 1.0 - c
    return np.array(
        [
            [c + k * x * x, k * x * y - s * z, k * x * z + s * y],
            [k * y * x + s * z, c + k * y * y, k * y * z - s * x],
            [k * z * x - s * y, k * z * y + s * x, c + k * z * z],
        ]
    )


@_jit
def _evaluate(c, R, t, states, beta, points, jacobian, derivatives):
    """Camera-space keypoints (M, 3) and, where asked, their derivative (M, 3, P)."""
    M, _, D = c.basis.shape
    J = len(c.parents)
    axes, pivots = np.empty((J, 3)), np.empty((J, 3))
    d_axes, d_pivots = np.zeros((J, 3, D)), np.zeros((J, 3, D))
    _joints(c, beta, axes, pivots, d_axes, d_pivots, derivatives)
    F = np.empty((J, 3, 3))
    for j in range(J):
        F[j] = _rodrigues(axes[j], states[j]) if c.revolute[j] else np.eye(3)

    v, moved, du = np.empty(3), np.empty(3), np.empty(3)
    by_state, by_beta, turned_beta = np.empty((3, J)), np.empty((3, D)), np.empty((3, D))
    for m in range(M):
        for i in range(3):
            total = 0.0
            for d in range(D):
                total += c.basis[m, i, d] * beta[d]
                by_beta[i, d] = c.basis[m, i, d]
            v[i] = total
        by_state[:] = 0.0
        part = c.part_of[m]
        while part > 0:  # from the part's own joint up to the root, carrying point and derivatives along
            j = part - 1
            u = axes[j]
            if c.revolute[j]:
                arm = v - pivots[j]
                for i in range(3):
                    moved[i] = F[j, i, 0] * arm[0] + F[j, i, 1] * arm[1] + F[j, i, 2] * arm[2]
                if derivatives:
                    s, k = math.sin(states[j]), 1.0 - math.cos(states[j])
                    along = u[0] * arm[0] + u[1] * arm[1] + u[2] * arm[2]
                    for b in range(J):
                        x, y, z = by_state[0, b], by_state[1, b], by_state[2, b]
                        for i in range(3):
                            by_state[i, b] = F[j, i, 0] * x + F[j, i, 1] * y + F[j, i, 2] * z
                    by_state[0, j] = u[1] * moved[2] - u[2] * moved[1]
                    by_state[1, j] = u[2] * moved[0] - u[0] * moved[2]
                    by_state[2, j] = u[0] * moved[1] - u[1] * moved[0]
                    for d in range(D):
                        for i in range(3):
                            du[i] = d_axes[j, i, d]
                        dot = arm[0] * du[0] + arm[1] * du[1] + arm[2] * du[2]
                        cross0 = du[1] * arm[2] - du[2] * arm[1]
                        cross1 = du[2] * arm[0] - du[0] * arm[2]
                        cross2 = du[0] * arm[1] - du[1] * arm[0]
                        x = by_beta[0, d] - d_pivots[j, 0, d]
                        y = by_beta[1, d] - d_pivots[j, 1, d]
                        z = by_beta[2, d] - d_pivots[j, 2, d]
                        for i in range(3):
                            cross = cross0 if i == 0 else (cross1 if i == 1 else cross2)
                            turned_beta[i, d] = (
                                F[j, i, 0] * x
                                + F[j, i, 1] * y
                                + F[j, i, 2] * z
                                + d_pivots[j, i, d]
                                + s * cross
                                + k * (along * du[i] + u[i] * dot)
                            )
                    by_beta[:] = turned_beta
                for i in range(3):
                    v[i] = moved[i] + pivots[j, i]
            else:
                for i in range(3):
                    v[i] += states[j] * u[i]
                    by_state[i, j] = u[i]
                    for d in range(D):
                        by_beta[i, d] += states[j] * d_axes[j, i, d]
            part = c.parents[j]
        x, y, z = v[0], v[1], v[2]
        for i in range(3):
            moved[i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
            points[m, i] = moved[i] + t[i]
        if derivatives:
            J_m = jacobian[m]
            J_m[0, 0], J_m[0, 1], J_m[0, 2] = 0.0, moved[2], -moved[1]
            J_m[1, 0], J_m[1, 1], J_m[1, 2] = -moved[2], 0.0, moved[0]
            J_m[2, 0], J_m[2, 1], J_m[2, 2] = moved[1], -moved[0], 0.0
            for i in range(3):
                for n in range(3):
                    J_m[i, 3 + n] = 1.0 if i == n else 0.0
                for b in range(J):
                    J_m[i, 6 + b] = R[i, 0] * by_state[0, b] + R[i, 1] * by_state[1, b] + R[i, 2] * by_state[2, b]
                for d in range(D):
                    J_m[i, 6 + J + d] = R[i, 0] * by_beta[0, d] + R[i, 1] * by_beta[1, d] + R[i, 2] * by_beta[2, d]


@_jit
def _outside(state, low, high):
    return max(state - high, 0.0) + min(state - low, 0.0)


@_jit
def _cost(c, points, targets, weights, states, beta, limits):
    total = 0.0
    k = c.huber
    for m in range(len(points)):
        if weights[m] > 0.0:
            dx, dy, dz = points[m, 0] - targets[m, 0], points[m, 1] - targets[m, 1], points[m, 2] - targets[m, 2]
            s = weights[m] * (dx * dx + dy * dy + dz * dz)
            total += s if not s > k * k else 2.0 * k * math.sqrt(s) - k * k
    white = c.whitening @ (beta - c.beta_mean)
    total += (white * white).sum()
    for j in range(len(states)):
        over = c.limit_weight * _outside(states[j], limits[j, 0], limits[j, 1])
        total += over * over
    return total


@_jit
def _normal_equations(c, points, jacobian, targets, weights, states, beta, limits, A, g):
    """J^T W J and J^T W r over the free directions."""
    M, _, P = jacobian.shape
    J = len(states)
    full, gradient = np.zeros((P, P)), np.zeros(P)
    k = c.huber
    for m in range(M):
        w = weights[m]
        if not w > 0.0:
            continue
        r = points[m] - targets[m]
        s = w * (r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
        if s > k * k:
            w *= k / math.sqrt(s)
        for i in range(3):
            row = jacobian[m, i]
            for a in range(P):
                scaled = w * row[a]
                gradient[a] += scaled * r[i]
                for b in range(a + 1):
                    full[a, b] += scaled * row[b]
    for a in range(P):
        for b in range(a):
            full[b, a] = full[a, b]
    full[6 + J :, 6 + J :] += c.whitening.T @ c.whitening
    gradient[6 + J :] += c.whitening.T @ (c.whitening @ (beta - c.beta_mean))
    for j in range(J):
        over = _outside(states[j], limits[j, 0], limits[j, 1])
        if over != 0.0:
            full[6 + j, 6 + j] += c.limit_weight**2
            gradient[6 + j] += c.limit_weight**2 * over
    A[:] = c.free.T @ full @ c.free
    g[:] = c.free.T @ gradient


@_jit
def _solve(A, g, mu, step):
    """step = -(A + mu diag A)^-1 g by Cholesky; False where that is not positive definite."""
    n = len(g)
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            if i == j:
                total += mu * max(A[i, i], 1e-9)
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    for i in range(n):
        total = -g[i]
        for k in range(i):
            total -= L[i, k] * step[k]
        step[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, n):
            total -= L[k, i] * step[k]
        step[i] = total / L[i, i]
    return True


@_jit
def _minimise(c, targets, weights, limits, R, t, states, beta, A, max_iterations, step_tolerance):
    """One observation; R, t, states, beta are moved in place and A receives J^T J. Returns (converged, iterations)."""
    M, _, D = c.basis.shape
    J, F = len(states), c.free.shape[1]
    P = 6 + J + D
    points, jacobian = np.empty((M, 3)), np.zeros((M, 3, P))
    g, step = np.empty(F), np.empty(F)
    _evaluate(c, R, t, states, beta, points, jacobian, True)
    cost = _cost(c, points, targets, weights, states, beta, limits)
    _normal_equations(c, points, jacobian, targets, weights, states, beta, limits, A, g)
    if not math.isfinite(cost):
        return False, 0
    mu, growth = 1e-3, 2.0
    for iteration in range(1, max_iterations + 1):
        if not _solve(A, g, mu, step):
            mu, growth = mu * growth, 2.0 * growth
            if mu > 1e12:
                return False, iteration
            continue
        move = c.free @ step
        angle = math.sqrt(move[0] ** 2 + move[1] ** 2 + move[2] ** 2)
        R_new = _rodrigues(move[:3] / angle, angle) @ R if angle > 0.0 else R.copy()
        t_new = t + move[3:6]
        states_new = states + move[6 : 6 + J]
        beta_new = beta + move[6 + J :]
        _evaluate(c, R_new, t_new, states_new, beta_new, points, jacobian, False)
        new_cost = _cost(c, points, targets, weights, states_new, beta_new, limits)
        promised, largest = 0.0, 0.0
        for i in range(F):
            promised += step[i] * (mu * max(A[i, i], 1e-9) * step[i] - g[i])
            largest = max(largest, abs(step[i]))
        # see least_squares.minimise for why the damping follows the gain ratio
        accepted = new_cost < cost
        if accepted:
            gain = (cost - new_cost) / max(promised, 1e-300)
            mu = max(mu * min(max(1.0 - (2.0 * gain - 1.0) ** 3, 1.0 / 3.0), 2.0), 1e-12)
            growth = 2.0
            small_gain = cost - new_cost <= 1e-10 * cost
            R[:], t[:], states[:], beta[:] = R_new, t_new, states_new, beta_new
            cost = new_cost
            _evaluate(c, R, t, states, beta, points, jacobian, True)
            _normal_equations(c, points, jacobian, targets, weights, states, beta, limits, A, g)
            if small_gain:
                return True, iteration
        else:
            mu, growth = mu * growth, 2.0 * growth
        if largest < step_tolerance:
            return True, iteration
        if mu > 1e12:
            return False, iteration
    return False, max_iterations


@_jit
def _minimise_all(c, targets, weights, limits, R, t, states, beta, A, converged, iterations, most, tolerance):
    for b in range(len(R)):
        converged[b], iterations[b] = _minimise(
            c, targets[b], weights[b], limits[b], R[b], t[b], states[b], beta[b], A[b], most, tolerance
        )


def refine_with_kernel(prior: OmadPrior, targets, initial, limits: Tensor, config, free: Tensor):
    """Same contract as the torch version; arguments and results as ``refinement.refine`` uses them."""
    from .refinement import State, whitening

    def array(tensor: Tensor) -> np.ndarray:
        return np.ascontiguousarray(tensor.detach().cpu().numpy().astype(np.float64))

    problem = _Problem(
        basis=array(prior.basis),
        part_of=prior.part_of.cpu().numpy().astype(np.int64),
        parents=np.array(prior.tree.parents, dtype=np.int64),
        revolute=prior.revolute.cpu().numpy(),
        hidden_weight=array(prior.joint_hidden.weight),
        hidden_bias=array(prior.joint_hidden.bias),
        out_weight=array(prior.joint_out.weight),
        out_bias=array(prior.joint_out.bias),
        nominal_axes=array(prior.nominal_axes),
        beta_mean=array(prior.beta_mean),
        whitening=array(whitening(prior, config.prior_weight)),
        free=array(free),
        limit_weight=1 / config.limit_sigma,
        huber=math.inf if config.huber is None else config.huber,
    )
    pose = array(initial.T_camera_base)
    R, t = pose[:, :3, :3].copy(), pose[:, :3, 3].copy()
    states, beta = array(initial.joint_states).copy(), array(initial.beta).copy()
    batch, directions = len(R), free.shape[1]
    A = np.full((batch, directions, directions), np.nan)
    converged, iterations = np.zeros(batch, dtype=np.bool_), np.zeros(batch, dtype=np.int64)
    _minimise_all(
        problem, array(targets.keypoints), array(targets.weights), array(limits), R, t, states, beta, A,
        converged, iterations, config.max_iterations, config.step_tolerance,
    )  # fmt: skip
    pose[:, :3, :3], pose[:, :3, 3] = R, t
    like = targets.keypoints

    def tensor(values: np.ndarray) -> Tensor:
        return torch.as_tensor(values).to(like)

    state = State(beta=tensor(beta), joint_states=tensor(states), T_camera_base=tensor(pose))
    return state, tensor(A), torch.as_tensor(converged), torch.as_tensor(iterations)
