"""A category's prior in compiled loops on the CPU, float64: J(beta), part transforms, and the base under keypoints.

Explicit loops rather than array expressions, because those take several times longer to compile; compiled code is kept
on disk.

Keypoints M, joints J, |beta| D, hidden units H. A state is one row x of 12 + J + D numbers: base rotation row by row,
translation, joint states, beta.
"""

import math
from typing import NamedTuple

import numpy as np

from omad.common.arrays import as_doubles

from ...prior import OmadPrior
from .algebra import fit_rotation, inner, jit, rotation, times


class KernelPrior(NamedTuple):
    """Constants of a category, as arrays."""

    basis: np.ndarray  # (M, 3, D)
    part_of: np.ndarray  # (M,)
    parents: np.ndarray  # (J,)
    turn: np.ndarray  # (J,)
    slide: np.ndarray  # (J,)
    hidden_weight: np.ndarray  # (H, D)
    hidden_bias: np.ndarray  # (H,)
    out_weight: np.ndarray  # (6 J, H)
    out_bias: np.ndarray  # (6 J,)
    nominal_axes: np.ndarray  # (J, 3)


def kernel_prior(prior: OmadPrior) -> KernelPrior:
    """The prior's numbers as they are now."""
    tree, hidden, out = prior.tree, prior.joint_hidden, prior.joint_out
    turn, slide = (np.array([getattr(motion, kind) for motion in tree.motions]) for kind in ("turn", "slide"))
    learned = map(as_doubles, (hidden.weight, hidden.bias, out.weight, out.bias, prior.nominal_axes))
    parents = np.array(tree.parents, dtype=np.int64)
    return KernelPrior(as_doubles(prior.basis), prior.part_of.cpu().numpy(), parents, turn, slide, *learned)


@inner
def joint_function(c, beta, axes, pivots, d_axes, d_pivots):
    """J(beta) into axes, pivots (J, 3) and its derivatives (J, 3, D)."""
    H, D = c.hidden_weight.shape
    hidden, raw, slope = np.empty(H), np.empty(3), np.empty((3, D))
    for h in range(H):
        hidden[h] = c.hidden_bias[h]
        for d in range(D):
            hidden[h] += c.hidden_weight[h, d] * beta[d]
    for j in range(len(c.parents)):
        for first in (0, 3):  # axis, pivot
            for i in range(3):
                row = 6 * j + first + i
                raw[i] = c.out_bias[row]
                for d in range(D):
                    slope[i, d] = 0.0
                for h in range(H):
                    if hidden[h] > 0.0:
                        weight = c.out_weight[row, h]
                        raw[i] += weight * hidden[h]
                        for d in range(D):
                            slope[i, d] += weight * c.hidden_weight[h, d]
            if first == 0:
                for i in range(3):
                    raw[i] += c.nominal_axes[j, i]
                length = math.sqrt(raw[0] ** 2 + raw[1] ** 2 + raw[2] ** 2)
                for i in range(3):
                    axes[j, i] = raw[i] / length
                for d in range(D):
                    along = axes[j, 0] * slope[0, d] + axes[j, 1] * slope[1, d] + axes[j, 2] * slope[2, d]
                    for i in range(3):
                        d_axes[j, i, d] = (slope[i, d] - axes[j, i] * along) / length
            else:
                used = 1.0 if c.turn[j] != 0.0 else 0.0
                for i in range(3):
                    pivots[j, i] = used * raw[i]
                    for d in range(D):
                        d_pivots[j, i, d] = used * slope[i, d]


@inner
def place_parts(c, x, axes, pivots, G, g, lines, centres):
    """Part transforms, rotations into G (J + 1, 3, 3) and translations into g (J + 1, 3), and each joint's line carried
    by its parent part: directions into lines, points into centres (J, 3)."""
    turn, v = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        g[0, i] = x[9 + i]
        for n in range(3):
            G[0, i, n] = x[3 * i + n]
    for j in range(len(c.parents)):
        parent = c.parents[j]
        R, child, state = G[parent], G[j + 1], x[12 + j]
        times(R, axes[j], lines[j])
        times(R, pivots[j], centres[j])
        angle, slide = c.turn[j] * state, c.slide[j] * state
        rotation(axes[j], math.sin(angle), 1.0 - math.cos(angle), turn)
        for i in range(3):
            centres[j, i] += g[parent, i]
            for n in range(3):
                child[i, n] = R[i, 0] * turn[0, n] + R[i, 1] * turn[1, n] + R[i, 2] * turn[2, n]
        times(child, pivots[j], v)
        for i in range(3):
            g[j + 1, i] = centres[j, i] - v[i] + slide * lines[j, i]


@jit
def place_bases(c, targets, weights, rows):
    """Overwrite the base pose of every row x (B, 12 + J + D) with the one that brings its keypoints nearest to targets
    (B, M, 3): weighted least squares in closed form, as ``geometry.fit_transform``."""
    M, _, D = c.basis.shape
    J = len(c.parents)
    axes, pivots = np.empty((J, 3)), np.empty((J, 3))
    d_axes, d_pivots = np.empty((J, 3, D)), np.empty((J, 3, D))
    G, g = np.empty((J + 1, 3, 3)), np.empty((J + 1, 3))
    lines, centres = np.empty((J, 3)), np.empty((J, 3))
    points, v, turn = np.empty((M, 3)), np.empty(3), np.empty((3, 3))
    for o in range(len(rows)):
        x = rows[o]
        for i in range(12):
            x[i] = 1.0 if i < 9 and i % 4 == 0 else 0.0
        joint_function(c, x[12 + J :], axes, pivots, d_axes, d_pivots)
        place_parts(c, x, axes, pivots, G, g, lines, centres)
        mean, target_mean, total = np.zeros(3), np.zeros(3), 0.0
        for m in range(M):
            if weights[o, m] == 0.0:
                continue
            part = c.part_of[m]
            for i in range(3):
                v[i] = 0.0
                for d in range(D):
                    v[i] += c.basis[m, i, d] * x[12 + J + d]
            times(G[part], v, points[m])
            total += weights[o, m]
            for i in range(3):
                points[m, i] += g[part, i]
                mean[i] += weights[o, m] * points[m, i]
                target_mean[i] += weights[o, m] * targets[o, m, i]
        mean /= total
        target_mean /= total
        moment = np.zeros((3, 3))
        for m in range(M):
            if weights[o, m] == 0.0:
                continue
            for i in range(3):
                for n in range(3):
                    off = targets[o, m, i] - target_mean[i]
                    moment[i, n] += weights[o, m] * off * (points[m, n] - mean[n])
        fit_rotation(moment, turn)
        for i in range(3):
            x[9 + i] = target_mean[i]
            for n in range(3):
                x[3 * i + n] = turn[i, n]
                x[9 + i] -= turn[i, n] * mean[n]
