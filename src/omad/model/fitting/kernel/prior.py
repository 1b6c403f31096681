"""A category's prior in compiled loops on the CPU, float64: J(beta), where parts and keypoints are, and the base under
seen keypoints.

Explicit loops rather than array expressions, because those take several times longer to compile; keypoints come last
in every array of theirs, so that the innermost loops run over them. Compiled code is kept on disk.

Keypoints M, joints J, parts K, |beta| D, hidden units H. A state is one row x of 16 + J + D numbers, as ``State.pack``
has them: base pose row by row, joint states, beta.
"""

import math
from typing import NamedTuple

import numpy as np

from omad.common.arrays import as_doubles
from omad.common.compiled import inner, jit

from ...prior import OmadPrior
from .algebra import dot, fit_rotation, rotation, times

FAR = 100.0
"""More standard deviations than any loose number is away from its mean."""


class KernelPrior(NamedTuple):
    """Constants of a category, as arrays."""

    basis: np.ndarray  # (3, D, M)
    ends: np.ndarray  # (K + 1,): keypoints ends[k] to ends[k + 1] are those of part k
    parents: np.ndarray  # (J,)
    turn: np.ndarray  # (J,)
    slide: np.ndarray  # (J,)
    hidden_weight: np.ndarray  # (D, H)
    hidden_bias: np.ndarray  # (H,)
    out_weight: np.ndarray  # (6 J, H)
    out_bias: np.ndarray  # (6 J,) the spec's axes included


class PlacedPrior(NamedTuple):
    """One object where it is: buffers that ``place`` fills."""

    hidden: np.ndarray  # (H,) of the joint function, after its ReLU
    axes: np.ndarray  # (J, 3) canonical
    lengths: np.ndarray  # (J,) of the axes before they were normalised
    pivots: np.ndarray  # (J, 3) canonical
    rotations: np.ndarray  # (K, 3, 3) of the parts, canonical to camera
    translations: np.ndarray  # (K, 3)
    lines: np.ndarray  # (J, 3) axes in the camera frame
    centres: np.ndarray  # (J, 3) pivots in the camera frame
    canonical: np.ndarray  # (3, M) keypoints
    points: np.ndarray  # (3, M) keypoints in the camera frame


def kernel_prior(prior: OmadPrior) -> KernelPrior:
    """The prior's numbers as they are now."""
    tree, hidden, out = prior.tree, prior.joint_hidden, prior.joint_out
    turn, slide = (np.array([getattr(motion, kind) for motion in tree.motions]) for kind in ("turn", "slide"))
    ends = np.array([0, *(part.stop for part in prior.keypoints_of_part)], dtype=np.int64)
    out_bias = as_doubles(out.bias).reshape(-1, 6) + as_doubles(prior.nominal_axes) @ np.eye(3, 6)
    hidden_weight, hidden_bias, out_weight = map(as_doubles, (hidden.weight.T, hidden.bias, out.weight))
    # a loose number of beta is a hidden unit that is always far from its ReLU's kink
    moves = np.pad(as_doubles(prior.pivot_basis), ((0, 0), (3, 0), (0, 0))).reshape(len(out_weight), -1)
    loose = moves.shape[1]
    hidden_weight = np.pad(hidden_weight, ((0, loose), (0, loose)))
    hidden_weight[prior.shape_size :, len(hidden_bias) :] = np.eye(loose)
    hidden_bias, out_weight = np.append(hidden_bias, np.full(loose, FAR)), np.hstack([out_weight, moves])
    out_bias = out_bias.ravel() - FAR * moves.sum(1)
    basis, parents = as_doubles(prior.basis.permute(1, 2, 0)), np.array(tree.parents, dtype=np.int64)
    return KernelPrior(basis, ends, parents, turn, slide, hidden_weight, hidden_bias, out_weight, out_bias)


@inner
def buffers(c):
    """For ``place``."""
    J, M, H = len(c.parents), c.basis.shape[2], len(c.hidden_bias)
    return PlacedPrior(
        np.empty(H), np.empty((J, 3)), np.empty(J), np.empty((J, 3)), np.empty((J + 1, 3, 3)), np.empty((J + 1, 3)),
        np.empty((J, 3)), np.empty((J, 3)), np.empty((3, M)), np.empty((3, M)),
    )  # fmt: skip


@inner
def _joint_function(c, beta, at):
    """J(beta)."""
    H, D = len(c.hidden_bias), len(beta)
    for h in range(H):
        at.hidden[h] = c.hidden_bias[h]
    for d in range(D):
        for h in range(H):
            at.hidden[h] += c.hidden_weight[d, h] * beta[d]
    for h in range(H):
        if at.hidden[h] < 0.0:
            at.hidden[h] = 0.0
    for j in range(len(c.parents)):
        squared = 0.0
        for i in range(3):
            at.axes[j, i] = c.out_bias[6 * j + i] + dot(c.out_weight[6 * j + i], at.hidden)
            squared += at.axes[j, i] ** 2
            at.pivots[j, i] = 0.0
            if c.turn[j] != 0.0:
                at.pivots[j, i] = c.out_bias[6 * j + 3 + i] + dot(c.out_weight[6 * j + 3 + i], at.hidden)
        at.lengths[j] = math.sqrt(squared)
        for i in range(3):
            at.axes[j, i] /= at.lengths[j]


@inner
def joint_slopes(c, at, d_axes, d_pivots):
    """Derivatives (J, 3, D) of the joint function by beta, at the state that was placed last."""
    D, H = c.hidden_weight.shape
    reach = np.empty((D, H))
    for d in range(D):
        for h in range(H):
            reach[d, h] = c.hidden_weight[d, h] if at.hidden[h] > 0.0 else 0.0
    for j in range(len(c.parents)):
        for d in range(D):
            along = 0.0
            for i in range(3):
                d_axes[j, i, d] = dot(c.out_weight[6 * j + i], reach[d])
                along += at.axes[j, i] * d_axes[j, i, d]
                d_pivots[j, i, d] = dot(c.out_weight[6 * j + 3 + i], reach[d]) if c.turn[j] != 0.0 else 0.0
            for i in range(3):
                d_axes[j, i, d] = (d_axes[j, i, d] - at.axes[j, i] * along) / at.lengths[j]


@inner
def place(c, x, at):
    """Fill ``at`` with the object of the state x."""
    _, D, M = c.basis.shape
    J = len(c.parents)
    G, g, turn, v = at.rotations, at.translations, np.empty((3, 3)), np.empty(3)
    _joint_function(c, x[16 + J :], at)
    for i in range(3):
        g[0, i] = x[4 * i + 3]
        for n in range(3):
            G[0, i, n] = x[4 * i + n]
    for j in range(J):
        parent = c.parents[j]
        R, child, state = G[parent], G[j + 1], x[16 + j]
        times(R, at.axes[j], at.lines[j])
        times(R, at.pivots[j], at.centres[j])
        angle, slide = c.turn[j] * state, c.slide[j] * state
        rotation(at.axes[j], math.sin(angle), 1.0 - math.cos(angle), turn)
        for i in range(3):
            at.centres[j, i] += g[parent, i]
            for n in range(3):
                child[i, n] = R[i, 0] * turn[0, n] + R[i, 1] * turn[1, n] + R[i, 2] * turn[2, n]
        times(child, at.pivots[j], v)
        for i in range(3):
            g[j + 1, i] = at.centres[j, i] - v[i] + slide * at.lines[j, i]
    p = at.canonical
    for i in range(3):
        for m in range(M):
            p[i, m] = 0.0
        for d in range(D):
            for m in range(M):
                p[i, m] += c.basis[i, d, m] * x[16 + J + d]
    for k in range(J + 1):
        rest, moved = p[:, c.ends[k] : c.ends[k + 1]], at.points[:, c.ends[k] : c.ends[k + 1]]
        for i in range(3):
            x, y, z, t = G[k, i, 0], G[k, i, 1], G[k, i, 2], g[k, i]
            for m in range(rest.shape[1]):
                moved[i, m] = x * rest[0, m] + y * rest[1, m] + z * rest[2, m] + t


@jit
def place_bases(c, targets, weights, rows):
    """Overwrite the base pose of every row x (B, 16 + J + D) with the one that brings its keypoints nearest to targets
    (B, M, 3): weighted least squares in closed form, as ``geometry.fit_transform``."""
    M = c.basis.shape[2]
    at, turn = buffers(c), np.empty((3, 3))
    mean, target_mean, moment = np.empty(3), np.empty(3), np.empty((3, 3))
    for o in range(len(rows)):
        x = rows[o]
        for i in range(16):
            x[i] = 1.0 if i % 5 == 0 else 0.0
        place(c, x, at)
        total = 0.0
        mean[:], target_mean[:], moment[:] = 0.0, 0.0, 0.0
        for m in range(M):
            if weights[o, m] == 0.0:
                continue
            total += weights[o, m]
            for i in range(3):
                mean[i] += weights[o, m] * at.points[i, m]
                target_mean[i] += weights[o, m] * targets[o, m, i]
        for i in range(3):
            mean[i] /= total
            target_mean[i] /= total
        for m in range(M):
            if weights[o, m] == 0.0:
                continue
            for i in range(3):
                off = weights[o, m] * (targets[o, m, i] - target_mean[i])
                for n in range(3):
                    moment[i, n] += off * (at.points[n, m] - mean[n])
        fit_rotation(moment, turn)
        for i in range(3):
            x[4 * i + 3] = target_mean[i]
            for n in range(3):
                x[4 * i + n] = turn[i, n]
                x[4 * i + 3] -= turn[i, n] * mean[n]
