"""Compiled loops that pose and look at surface samples on the CPU, for ``training_views``.

float32, C-contiguous. B views, S samples of each object, K parts; results go into the last arguments.
"""

import math

import numpy as np

from omad.common.compiled import jit


@jit
def pose(points, normals, labels, indices, scale, T_base_part, posed, turned, centre, radius):
    """Samples ``points`` and ``normals`` (N, S, 3) of the objects ``indices`` (B,), stretched by ``scale`` (B, 3) and
    carried by the parts' poses (B, K, 4, 4) -> (B, S, 3) each, and the bounding sphere's ``centre`` (B, 3), that of the
    box, and ``radius`` (B,)."""
    S = points.shape[1]
    low, high = np.empty(3, np.float32), np.empty(3, np.float32)
    for b in range(len(indices)):
        o, sx, sy, sz = indices[b], scale[b, 0], scale[b, 1], scale[b, 2]
        low[:], high[:] = np.inf, -np.inf
        for s in range(S):
            T = T_base_part[b, labels[o, s]]
            x, y, z = points[o, s, 0] * sx, points[o, s, 1] * sy, points[o, s, 2] * sz
            u, v, w = normals[o, s, 0] / sx, normals[o, s, 1] / sy, normals[o, s, 2] / sz
            length = max(math.sqrt(u * u + v * v + w * w), 1e-12)
            for i in range(3):
                at = T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3]
                posed[b, s, i] = at
                turned[b, s, i] = (T[i, 0] * u + T[i, 1] * v + T[i, 2] * w) / length
                low[i], high[i] = min(low[i], at), max(high[i], at)
        for i in range(3):
            centre[b, i] = 0.5 * (low[i] + high[i])
        furthest = 0.0
        for s in range(S):
            square = 0.0
            for i in range(3):
                square += (posed[b, s, i] - centre[b, i]) ** 2
            furthest = max(furthest, square)
        radius[b] = math.sqrt(furthest)


@jit
def look(points, normals, closed, T_camera_base, steepest, facing):
    """Carry ``points`` (B, S, 3) to the camera, in place, and say which face it, (B, S) bool: with a larger cosine
    between ray and normal than ``steepest`` (B,), and not from behind where the surface is ``closed`` (B,)."""
    for b in range(len(points)):
        T = T_camera_base[b]
        for s in range(points.shape[1]):
            x, y, z = points[b, s, 0], points[b, s, 1], points[b, s, 2]
            u, v, w = normals[b, s, 0], normals[b, s, 1], normals[b, s, 2]
            dot, square = 0.0, 0.0
            for i in range(3):
                at = T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3]
                points[b, s, i] = at
                dot -= at * (T[i, 0] * u + T[i, 1] * v + T[i, 2] * w)
                square += at * at
            cosine = dot / math.sqrt(square)
            facing[b, s] = (cosine > 0 or not closed[b]) and abs(cosine) > steepest[b]


@jit
def nearest_of_cell(points, centre, half_extent, cells, seen):
    """Point z-buffer: whether each of ``points`` (B, S, 3) is the nearest of its image cell, (B, S) bool. ``cells`` x
    ``cells`` of them reach ``half_extent`` (B,) around the ray to ``centre`` (B, 3)."""
    S = points.shape[1]
    nearest, cell = np.empty(cells * cells, np.float32), np.empty(S, np.int32)
    for b in range(len(points)):
        nearest[:] = np.inf
        to_cell = np.float32(cells / 2) / half_extent[b]
        x0, y0 = centre[b, 0] / centre[b, 2], centre[b, 1] / centre[b, 2]
        for s in range(S):
            z = points[b, s, 2]
            column = int((points[b, s, 0] / z - x0 + half_extent[b]) * to_cell)
            row = int((points[b, s, 1] / z - y0 + half_extent[b]) * to_cell)
            cell[s] = min(max(row, 0), cells - 1) * cells + min(max(column, 0), cells - 1)
            nearest[cell[s]] = min(nearest[cell[s]], z)
        for s in range(S):
            seen[b, s] = points[b, s, 2] <= nearest[cell[s]]
