"""The energy of ``..energy`` at one state, and its derivatives, in compiled loops.

Keypoints M, joints J, |beta| D, unknowns P = 6 + J + D in the order of ``..state``. The energy alone costs a small part
of its derivatives, so that a step that is turned down is cheap.
"""

import math
from typing import NamedTuple

import numpy as np

from omad.common.compiled import inner

from .algebra import dot
from .prior import KernelPrior, joint_slopes, place


class KernelProblem(NamedTuple):
    """Constants of a refinement, as arrays."""

    prior: KernelPrior
    beta_mean: np.ndarray  # (D,)
    whitening: np.ndarray  # (D, D) upper triangular
    free: np.ndarray  # (P, F)
    limit_weight: float
    huber: float  # infinity: plain squares


@inner
def evaluate(c, x, targets, weights, limits, at, root, off):
    """The energy at x. Filled: ``at`` with the object, ``off`` (3, M) with its keypoints' distances from the targets
    where they count (0 elsewhere), and ``root`` (M,) with the square roots of the weights that robustness leaves."""
    J = len(c.prior.parents)
    M, D = len(root), len(c.beta_mean)
    place(c.prior, x, at)
    cost = 0.0
    for m in range(M):
        w, squared = weights[m], 0.0
        for i in range(3):
            off[i, m] = 0.0 if w == 0.0 else at.points[i, m] - targets[m, i]
            squared += off[i, m] ** 2
        term = w * squared
        root[m] = math.sqrt(w)
        if term > c.huber**2:
            length = math.sqrt(term)
            root[m] *= math.sqrt(c.huber / length)
            term = c.huber * (2.0 * length - c.huber)
        cost += term
    for i in range(D):
        white = 0.0
        for d in range(i, D):
            white += c.whitening[i, d] * (x[16 + J + d] - c.beta_mean[d])
        cost += white * white
    for j in range(J):
        cost += (c.limit_weight * _outside(x[16 + j], limits[j])) ** 2
    return cost


@inner
def differentiate(c, x, limits, at, root, off, gradient, hessian):
    """J^T r (P,) and J^T J (P, P) of the state that was evaluated last; ``off`` comes back weighted."""
    D, J, M = len(c.beta_mean), len(c.prior.parents), len(root)
    S, B, P = 6, 6 + J, 6 + J + D  # where joint states and beta begin
    rows = np.zeros((P, 3, M))
    _keypoint_rows(c.prior, x, at, rows)
    for i in range(3):
        for m in range(M):
            off[i, m] *= root[m]
        for a in range(P):
            for m in range(M):
                rows[a, i, m] *= root[m]
    flat, seen = rows.reshape(P, 3 * M), off.reshape(3 * M)
    for a in range(P):
        gradient[a] = dot(flat[a], seen)
        for b in range(a + 1):
            hessian[a, b] = dot(flat[a], flat[b])
            hessian[b, a] = hessian[a, b]
    for i in range(D):
        white = 0.0
        for d in range(i, D):
            white += c.whitening[i, d] * (x[16 + J + d] - c.beta_mean[d])
        for a in range(i, D):
            gradient[B + a] += c.whitening[i, a] * white
            for b in range(i, D):
                hessian[B + a, B + b] += c.whitening[i, a] * c.whitening[i, b]
    for j in range(J):
        outside = _outside(x[16 + j], limits[j])
        if outside != 0.0:
            gradient[S + j] += c.limit_weight**2 * outside
            hessian[S + j, S + j] += c.limit_weight**2


@inner
def _outside(state, limits):
    """How far a joint state is above its upper limit, or (negative) below its lower one."""
    return max(state - limits[1], 0.0) + min(state - limits[0], 0.0)


@inner
def _keypoint_rows(c, x, at, rows):
    """Derivatives of the placed keypoints by every unknown, into rows (P, 3, M), which are zero before."""
    _, D, M = c.basis.shape
    J = len(c.parents)
    S, B = 6, 6 + J
    G, g, p, centres = at.rotations, at.translations, at.points, at.centres
    for m in range(M):
        X, Y, Z = p[0, m] - g[0, 0], p[1, m] - g[0, 1], p[2, m] - g[0, 2]
        rows[0, 1, m], rows[0, 2, m] = -Z, Y
        rows[1, 0, m], rows[1, 2, m] = Z, -X
        rows[2, 0, m], rows[2, 1, m] = -Y, X
        rows[3, 0, m] = rows[4, 1, m] = rows[5, 2, m] = 1.0
    for k in range(J + 1):
        own, basis = rows[B:, :, c.ends[k] : c.ends[k + 1]], c.basis[:, :, c.ends[k] : c.ends[k + 1]]
        for i in range(3):
            X, Y, Z = G[k, i, 0], G[k, i, 1], G[k, i, 2]
            for d in range(D):
                for m in range(own.shape[2]):
                    own[d, i, m] = X * basis[0, d, m] + Y * basis[1, d, m] + Z * basis[2, d, m]

    # With R the rotation of the parent and R' of the child, a point below the joint moves by K (R du) + (R - R') dq;
    # both brackets are made here.
    d_axes, d_pivots = np.empty((J, 3, D)), np.empty((J, 3, D))
    by_axis, by_pivot = np.zeros((J, 3, D)), np.zeros((J, 3, D))
    joint_slopes(c, at, d_axes, d_pivots)
    for j in range(J):
        R, child = G[c.parents[j]], G[j + 1]
        for i in range(3):
            for n in range(3):
                for d in range(D):
                    by_axis[j, i, d] += R[i, n] * d_axes[j, n, d]
                    by_pivot[j, i, d] += (R[i, n] - child[i, n]) * d_pivots[j, n, d]
    K = np.empty((3, 3, M))
    for k in range(1, J + 1):
        first, last, part = c.ends[k], c.ends[k + 1], k
        own, points = rows[:, :, first:last], p[:, first:last]
        while part > 0:  # every joint between the part and the root
            j = part - 1
            part = c.parents[j]
            ux, uy, uz = at.lines[j]
            turn, slide, state = c.turn[j], c.slide[j], x[16 + j]
            s, versine, shift = math.sin(turn * state), 1.0 - math.cos(turn * state), slide * state
            qx, qy, qz = centres[j, 0] + shift * ux, centres[j, 1] + shift * uy, centres[j, 2] + shift * uz
            for m in range(last - first):
                X, Y, Z = points[0, m] - qx, points[1, m] - qy, points[2, m] - qz
                vx, vy, vz = uy * Z - uz * Y, uz * X - ux * Z, ux * Y - uy * X
                along = ux * X + uy * Y + uz * Z
                own[S + j, 0, m] = turn * vx + slide * ux
                own[S + j, 1, m] = turn * vy + slide * uy
                own[S + j, 2, m] = turn * vz + slide * uz
                # as it was before the joint turned it
                X += versine * (along * ux - X) - s * vx
                Y += versine * (along * uy - Y) - s * vy
                Z += versine * (along * uz - Z) - s * vz
                diagonal = versine * along + shift
                K[0, 0, m], K[1, 1, m], K[2, 2, m] = (
                    versine * ux * X + diagonal, versine * uy * Y + diagonal, versine * uz * Z + diagonal,
                )  # fmt: skip
                K[0, 1, m], K[1, 0, m] = versine * ux * Y + s * Z, versine * uy * X - s * Z
                K[0, 2, m], K[2, 0, m] = versine * ux * Z - s * Y, versine * uz * X + s * Y
                K[1, 2, m], K[2, 1, m] = versine * uy * Z + s * X, versine * uz * Y - s * X
            for d in range(D):
                for i in range(3):
                    X, Y, Z, fixed = by_axis[j, 0, d], by_axis[j, 1, d], by_axis[j, 2, d], by_pivot[j, i, d]
                    for m in range(own.shape[2]):
                        own[B + d, i, m] += K[i, 0, m] * X + K[i, 1, m] * Y + K[i, 2, m] * Z + fixed
