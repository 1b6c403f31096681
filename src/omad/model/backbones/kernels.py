"""Compiled loops on the CPU between the matrix products of PointNet++: what makes, fills and empties groups.

float32, C-contiguous. B clouds, N points, n centres, k neighbours, C features; results go into the last arguments.
``point_ops`` wraps them for training; ``inference`` strings them together without a tensor operation between.
"""

import numpy as np

from omad.common.compiled import compiled

jit = compiled(fastmath={"contract", "reassoc", "nsz"})


LANES = 32
"""Queries that are searched for side by side."""


@jit
def nearest(queries, points, candidates, squared, index):
    """The k nearest of the first ``candidates`` of ``points`` (B, N, 3) to the first n of the ``queries``, nearest
    first, with their squared distances (B, n, k); of two equally near the earlier. Where there are
    fewer than k the last are the first point, infinitely far."""
    B, n, k = index.shape
    # Distances stand in 4 k columns. At least k of them are not above the k-th smallest of the columns' minima, and
    # hardly more: few are left to be ranked, in few columns. All but the gathering of those runs in vectors.
    columns = 4 * k
    rows = (candidates + columns - 1) // columns
    x, y, z, distance = np.full((4, rows * columns), np.inf, np.float32)
    lowest, rank = np.empty(columns, np.float32), np.empty(rows * columns, np.int32)
    few, which = np.empty(rows * columns + 1, np.float32), np.empty(rows * columns + 1, np.int32)
    column = np.empty(columns + 1, np.int64)
    for b in range(B):
        for j in range(candidates):
            x[j], y[j], z[j] = points[b, j, 0], points[b, j, 1], points[b, j, 2]
        for q in range(n):
            qx, qy, qz = queries[b, q, 0], queries[b, q, 1], queries[b, q, 2]
            for j in range(rows * columns):
                dx, dy, dz = x[j] - qx, y[j] - qy, z[j] - qz
                distance[j] = dx * dx + dy * dy + dz * dz
            for c in range(columns):
                lowest[c] = distance[c]
            for r in range(1, rows):
                for c in range(columns):
                    d = distance[r * columns + c]
                    lowest[c] = d if d < lowest[c] else lowest[c]
            limit = _smallest(lowest, k, rank)
            # written whether they count or not, as a branch that is hard to foresee costs more
            near, count = 0, 0
            for c in range(columns):
                column[near] = c
                near += lowest[c] <= limit
            for i in range(near):
                for j in range(column[i], candidates, columns):
                    few[count], which[count] = distance[j], j
                    count += distance[j] <= limit
            _ranks(few, which, count, rank)
            for i in range(count, k):
                squared[b, q, i], index[b, q, i] = np.inf, 0
            for i in range(count):
                if rank[i] < k:
                    squared[b, q, rank[i]], index[b, q, rank[i]] = few[i], which[i]


@jit
def _smallest(values, k, rank):
    """The k-th smallest of ``values``; ``rank`` is for the work."""
    n = np.int32(len(values))
    for i in range(n):
        rank[i] = 0
    for j in range(n):
        value = values[j]
        for i in range(n):
            rank[i] += np.int32(value < values[i])
    limit = np.float32(-np.inf)
    for i in range(n):
        limit = values[i] if rank[i] < k and values[i] > limit else limit
    return limit


@jit
def _ranks(values, index, count, rank):
    """How many of the first ``count`` values come before each; of equals those of a lower ``index``."""
    for i in range(count):
        rank[i] = 0
    for j in range(np.int32(count)):
        value, own = values[j], index[j]
        for i in range(np.int32(count)):
            rank[i] += np.int32((value < values[i]) | ((value == values[i]) & (own < index[i])))


@jit
def nearest_three(queries, points, candidates, squared, index):
    """``nearest`` for k = 3, which is quicker with a query in each lane of the vectors."""
    B, n, _ = index.shape
    # one array of each type: rows of several would have to be checked for overlap before each loop
    at, near, who = np.zeros(3 * LANES, np.float32), np.empty(3 * LANES, np.float32), np.empty(3 * LANES, np.int32)
    for b in range(B):
        for start in range(0, n, LANES):
            some = min(LANES, n - start)
            for q in range(some):
                for axis in range(3):
                    at[axis * LANES + q] = queries[b, start + q, axis]
            near[:], who[:] = np.inf, 0
            for j in range(np.int32(candidates)):
                px, py, pz = points[b, j, 0], points[b, j, 1], points[b, j, 2]
                for q in range(LANES):
                    dx, dy, dz = at[q] - px, at[LANES + q] - py, at[2 * LANES + q] - pz
                    d = dx * dx + dy * dy + dz * dz
                    one, two, three = near[q], near[LANES + q], near[2 * LANES + q]
                    first, second, third = who[q], who[LANES + q], who[2 * LANES + q]
                    who[2 * LANES + q] = second if d < two else (j if d < three else third)
                    near[2 * LANES + q] = two if d < two else (d if d < three else three)
                    who[LANES + q] = first if d < one else (j if d < two else second)
                    near[LANES + q] = one if d < one else (d if d < two else two)
                    who[q] = j if d < one else first
                    near[q] = d if d < one else one
            for q in range(some):
                for i in range(3):
                    squared[b, start + q, i], index[b, start + q, i] = near[i * LANES + q], who[i * LANES + q]


@jit
def fill_groups(values, centres, index, grouped):
    """relu(``values`` (B, N, C) at ``index`` (B, n, k) - ``centres`` (B, n, C)) -> (B, n * k, C)."""
    B, n, k = index.shape
    C = values.shape[2]
    for b in range(B):
        for i in range(n):
            for m in range(k):
                j, row = index[b, i, m], i * k + m
                for c in range(C):
                    grouped[b, row, c] = max(values[b, j, c] - centres[b, i, c], np.float32(0))


@jit
def max_of_groups(grouped, bias, most, which):
    """Largest row by feature of each group of ``grouped`` (B, n * k, C), plus ``bias`` (C,), -> (B, n, C), and which
    of the group it is, (B, n, C) uint8."""
    B, n, C = most.shape
    k = grouped.shape[1] // n
    for b in range(B):
        for i in range(n):
            for c in range(C):
                most[b, i, c], which[b, i, c] = grouped[b, i * k, c], 0
            for m in range(1, k):
                row = i * k + m
                for c in range(C):
                    larger = grouped[b, row, c] > most[b, i, c]
                    most[b, i, c] = grouped[b, row, c] if larger else most[b, i, c]
                    which[b, i, c] = m if larger else which[b, i, c]
            for c in range(C):
                most[b, i, c] += bias[c]


@jit
def _sort_by_place(place, ends, order):
    """Features ``order[ends[m] : ends[m + 1]]`` are those whose ``place`` is m."""
    ends[:] = 0
    for c in range(len(place)):
        ends[place[c] + 1] += 1
    for m in range(len(ends) - 1):
        ends[m + 1] += ends[m]
    for c in range(len(place) - 1, -1, -1):
        ends[place[c] + 1] -= 1
        order[ends[place[c] + 1]] = c
    # what was taken off an end has made it the next one's beginning
    for m in range(len(ends) - 1):
        ends[m] = ends[m + 1]
    ends[len(ends) - 1] = len(place)


@jit
def max_of_groups_backward(
    values, centres, index, weight, which, gradient, d_values, d_centres, d_weight, d_bias
):  # fmt: skip
    """Of the maximum over groups of ``relu(values at index - centres) @ weight.T + bias``. Only one row of a group
    counts for a feature, so that sums over few rows take the place of products with matrices that are mostly zero.
    ``gradient`` (B, n, C); the ``d_`` arrays are added to."""
    B, n, k = index.shape
    C, F = weight.shape
    row, d_row = np.empty((2, F), np.float32)
    ends, order = np.empty(k + 1, np.int64), np.empty(C, np.int64)
    for b in range(B):
        for i in range(n):
            for c in range(C):
                d_bias[c] += gradient[b, i, c]
            _sort_by_place(which[b, i], ends, order)
            for m in range(k):
                if ends[m] == ends[m + 1]:
                    continue
                j = index[b, i, m]
                for f in range(F):
                    row[f], d_row[f] = max(values[b, j, f] - centres[b, i, f], np.float32(0)), 0.0
                for o in range(ends[m], ends[m + 1]):
                    c = order[o]
                    g = gradient[b, i, c]
                    for f in range(F):
                        d_weight[c, f] += g * row[f]
                    for f in range(F):
                        d_row[f] += g * weight[c, f]
                for f in range(F):
                    d = d_row[f] if row[f] > 0 else np.float32(0)
                    d_values[b, j, f] += d
                    d_centres[b, i, f] -= d


@jit
def blend(values, index, shares, out):
    """Sums of rows of ``values`` (B, n, C) at ``index`` (B, N, 3), weighted by ``shares`` (B, N, 3), -> (B, N, C)."""
    for b in range(len(values)):
        for i in range(out.shape[1]):
            one, two, three = values[b, index[b, i, 0]], values[b, index[b, i, 1]], values[b, index[b, i, 2]]
            u, v, w, row = shares[b, i, 0], shares[b, i, 1], shares[b, i, 2], out[b, i]
            for c in range(values.shape[2]):
                row[c] = u * one[c] + v * two[c] + w * three[c]


@jit
def blend_backward(index, shares, gradient, d_values):
    """Of ``blend`` by its values; ``d_values`` (B, n, C) is added to."""
    for b in range(len(d_values)):
        for i in range(gradient.shape[1]):
            row = gradient[b, i]
            for m in range(3):
                d_value, share = d_values[b, index[b, i, m]], shares[b, i, m]
                for c in range(len(row)):
                    d_value[c] += share * row[c]
