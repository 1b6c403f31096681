"""Compiled loops over the sub-cells of pictures on the CPU, for ``outline``.

float32, C-contiguous. B views, S samples of each object; results go into the arguments that are named last.
"""

import numpy as np

from omad.common.compiled import inner, jit


@jit
def outline(points, seen, middle, half, depth, steps, owner, across, reach):
    """Depth and distance from the outline, (B, across^2) each, of samples ``points`` (B, S, 3), and in ``owner``
    (B, across^2 / 4) which of those ``seen`` (B, S) lies in each cell of two by two."""
    area, cells = across * across, across // 2
    front = np.empty((2, area), np.int64)
    near, wide = np.empty(area, np.float32), np.empty(area, np.float32)
    owner[:] = -1
    for b in range(len(points)):
        near[:] = 0
        scale = np.float32(across / 2) / half[b]
        x0, y0 = middle[b, 0] - half[b], middle[b, 1] - half[b]
        for s in range(points.shape[1]):
            z = points[b, s, 2]
            column = min(max(int((points[b, s, 0] / z - x0) * scale), 0), across - 1)
            row = min(max(int((points[b, s, 1] / z - y0) * scale), 0), across - 1)
            at = row * across + column
            near[at] = max(near[at], np.float32(1) / z)
            if seen[b, s]:
                owner[b, (row // 2) * cells + column // 2] = s
        _close(near, wide, across)
        first = 0
        for at in range(area):
            depth[b, at] = near[at]
            steps[b, at] = -reach if near[at] > 0 else reach + 1
            if near[at] > 0 and _touches_outside(near, at, across):
                front[0, first] = at
                first += 1
        _inward(steps[b], front, first, across, reach)
        _outward(depth[b], steps[b], front, first, across, reach)
        for at in range(area):
            depth[b, at] = np.float32(1) / depth[b, at]


@inner
def _close(near, wide, across):
    """Fill gaps: what has the object, or the picture's border, on all sides and beside it."""
    for at in range(len(near)):
        row, column = at // across, at % across
        wide[at] = near[at]
        for r in range(max(row - 1, 0), min(row + 2, across)):
            for c in range(max(column - 1, 0), min(column + 2, across)):
                wide[at] = max(wide[at], near[r * across + c])
    for at in range(len(near)):
        if near[at] == 0 and wide[at] > 0 and not _touches_outside(wide, at, across):
            near[at] = wide[at]


@inner
def _touches_outside(near, at, across):
    row, column = at // across, at % across
    for r in range(max(row - 1, 0), min(row + 2, across)):
        for c in range(max(column - 1, 0), min(column + 2, across)):
            if near[r * across + c] == 0:
                return True
    return False


@inner
def _inward(steps, front, count, across, reach):
    """From the rim, ``count`` sub-cells in ``front[0]``, which stay there."""
    for i in range(count):
        steps[front[0, i]] = 0
        front[1, i] = front[0, i]
    begin, end = 0, count
    # the rings share one list: none is longer than the object
    for step in range(1, reach):
        last = end
        for i in range(begin, last):
            row, column = front[1, i] // across, front[1, i] % across
            for r in range(max(row - 1, 0), min(row + 2, across)):
                for c in range(max(column - 1, 0), min(column + 2, across)):
                    if steps[r * across + c] == -reach:
                        steps[r * across + c] = -step
                        front[1, end] = r * across + c
                        end += 1
        begin = last


@inner
def _outward(depth, steps, front, count, across, reach):
    """From the rim, ``count`` sub-cells in ``front[0]``; ``depth`` holds nearness, which is carried along."""
    begin, end = 0, count
    for step in range(1, reach + 1):
        last = end
        for i in range(begin, last):
            row, column = front[0, i] // across, front[0, i] % across
            for r in range(max(row - 1, 0), min(row + 2, across)):
                for c in range(max(column - 1, 0), min(column + 2, across)):
                    at = r * across + c
                    if steps[at] > step:
                        steps[at] = step
                        front[0, end] = at
                        end += 1
                    if steps[at] == step:
                        depth[at] = max(depth[at], depth[front[0, i]])
        begin = last
