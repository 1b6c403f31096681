"""Compiled loops between the matrix products of a forward pass, beside those of ``backbones.kernels``.

float32, C-contiguous. B clouds, N points, n centres, C features; results go into the last arguments.
"""

import math

import numpy as np

from ..backbones.kernels import jit

ONE = np.float32(1)
"""A plain 1 would turn what it meets into doubles."""
NARROW = np.float32(1e-5)
"""PyTorch's floor under the variance in LayerNorm."""
NEAR = np.float32(1e-6)
"""Floor under the squared distances of interpolation."""


@jit
def embed(points, weight, bias, out):
    """``points`` (B, N, 3) times ``weight`` (3, C) plus ``bias`` (C,) -> (B, n, C), for the first n points."""
    for b in range(len(out)):
        for i in range(out.shape[1]):
            x, y, z = points[b, i, 0], points[b, i, 1], points[b, i, 2]
            for c in range(len(bias)):
                out[b, i, c] = x * weight[0, c] + y * weight[1, c] + z * weight[2, c] + bias[c]


@jit
def add_embedded(points, weight, out):
    """The same without bias, added to ``out``."""
    for b in range(len(out)):
        for i in range(out.shape[1]):
            x, y, z = points[b, i, 0], points[b, i, 1], points[b, i, 2]
            for c in range(weight.shape[1]):
                out[b, i, c] += x * weight[0, c] + y * weight[1, c] + z * weight[2, c]


@jit
def add_relu(bias, rows):
    """``rows`` (n, C) plus ``bias`` (C,), negatives to zero."""
    for i in range(len(rows)):
        for c in range(len(bias)):
            rows[i, c] = max(rows[i, c] + bias[c], np.float32(0))


@jit
def add_each_relu(values, bias, out):
    """Adds one row a cloud, ``values`` (B, C), and ``bias`` to ``out`` (B, n, C), negatives to zero."""
    for b in range(len(out)):
        for i in range(out.shape[1]):
            for c in range(len(bias)):
                out[b, i, c] = max(out[b, i, c] + values[b, c] + bias[c], np.float32(0))


@jit
def add_blended_relu(values, index, squared, bias, out):
    """Adds ``values`` (B, n, C), interpolated by the inverse ``squared`` distances (B, N, 3) of the neighbours at
    ``index``, and ``bias`` to ``out`` (B, N, C), negatives to zero."""
    for b in range(len(out)):
        for i in range(out.shape[1]):
            u = ONE / (squared[b, i, 0] + NEAR)
            v = ONE / (squared[b, i, 1] + NEAR)
            w = ONE / (squared[b, i, 2] + NEAR)
            total = u + v + w
            u, v, w = u / total, v / total, w / total
            one, two, three = index[b, i, 0], index[b, i, 1], index[b, i, 2]
            for c in range(len(bias)):
                blended = u * values[b, one, c] + v * values[b, two, c] + w * values[b, three, c]
                out[b, i, c] = max(out[b, i, c] + blended + bias[c], np.float32(0))


@jit
def normalise(rows, bias, out):
    """``rows`` (n, C) with mean 0 and variance 1 each, into ``out``; ``bias`` (C,) is added to the rows themselves."""
    C = rows.shape[1]
    share = np.float32(1 / C)
    for i in range(len(rows)):
        total, square = np.float32(0), np.float32(0)
        for c in range(C):
            total += rows[i, c]
        mean = total * share
        for c in range(C):
            square += (rows[i, c] - mean) ** 2
        scale = np.float32(1 / math.sqrt(square * share + NARROW))
        for c in range(C):
            out[i, c] = (rows[i, c] - mean) * scale
            rows[i, c] += bias[c]


@jit
def cast_votes(points, votes, bias, attention, keypoints, log_sigma):
    """Keypoints (B, M, 3) and their log expected errors (B, M) from the ``votes`` (B, n, 5 M) of the first n
    ``points`` (B, N, 3): offset, score and log error of each keypoint, ``bias`` (5 M,) not added yet."""
    n, M = votes.shape[1], log_sigma.shape[1]
    for b in range(len(votes)):
        for m in range(M):
            highest = -np.inf
            for i in range(n):
                highest = max(highest, votes[b, i, 5 * m + 3])
            x, y, z, sigma, total = 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(n):
                share = math.exp(votes[b, i, 5 * m + 3] - highest) if attention else 1.0
                total += share
                x += share * (points[b, i, 0] + votes[b, i, 5 * m])
                y += share * (points[b, i, 1] + votes[b, i, 5 * m + 1])
                z += share * (points[b, i, 2] + votes[b, i, 5 * m + 2])
                sigma += share * votes[b, i, 5 * m + 4]
            keypoints[b, m, 0] = x / total + bias[5 * m]
            keypoints[b, m, 1] = y / total + bias[5 * m + 1]
            keypoints[b, m, 2] = z / total + bias[5 * m + 2]
            log_sigma[b, m] = sigma / total + bias[5 * m + 4]
