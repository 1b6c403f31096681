"""Which points of an observed cloud the network is shown: spread over the image, as those of training views are."""

import numpy as np

from omad.common.arrays import for_loops
from omad.common.compiled import inner, jit

CELLS_SEEN = 40
"""Cells across an observed cloud: of the same size, as a cloud fills about 0.85 of its object's sphere."""


def choose_points(points: np.ndarray, count: int, samples: int, seed: int) -> np.ndarray:
    """(samples, count) int64, independent choices of points of a cloud (N, 3), camera frame: each a random point of
    each of randomly chosen image cells; where there are too few cells, they repeat. The same on every machine, and the
    first samples are the same however many are drawn."""
    chosen = np.empty((samples, count), dtype=np.int64)
    _choose(for_loops(points, np.float32), CELLS_SEEN, np.uint64(seed), chosen)
    return chosen


@jit
def _choose(points, across, seed, chosen):
    """``choose_points`` into ``chosen``, with ``across`` cells along the cloud's longer side."""
    cell = _cells(points, across)
    start = np.zeros((across + 1) ** 2 + 1, np.int32)
    for c in cell:
        start[c + 1] += 1
    cells, occupied = 0, np.empty(len(start), np.int64)  # no np.flatnonzero, which takes a tenth of a second to load
    for c in range(len(start) - 1):
        if start[c + 1] > 0:
            occupied[cells] = c
            cells += 1
        start[c + 1] += start[c]
    members, filled = np.empty(len(points), np.int32), start.copy()
    for i in range(len(points)):
        members[filled[cell[i]]] = i
        filled[cell[i]] += 1

    stream = np.full(1, seed)
    for sample in chosen:
        for k in range(len(sample)):
            if k >= cells:
                sample[k] = sample[k - cells]
                continue
            other = k + _below(cells - k, stream)  # Fisher-Yates, as far as it is needed
            c = occupied[other]
            occupied[other], occupied[k] = occupied[k], c
            sample[k] = members[start[c] + _below(start[c + 1] - start[c], stream)]


@inner
def _cells(points, across):
    """(N,) the image cell that each point (N, 3) lies in, below (across + 1)^2."""
    # single precision and no min or max of numba's, which care for NaN, let these loops be vectorised
    zero, last, width = np.float32(0), np.float32(across), np.int32(across + 1)
    low_x, low_y, high_x, high_y = np.float32(np.inf), np.float32(np.inf), np.float32(-np.inf), np.float32(-np.inf)
    rays = np.empty((2, len(points)), np.float32)
    for i in range(len(points)):
        nearness = np.float32(1) / points[i, 2]
        x, y = points[i, 0] * nearness, points[i, 1] * nearness
        rays[0, i], rays[1, i] = x, y
        low_x, high_x = x if x < low_x else low_x, x if x > high_x else high_x
        low_y, high_y = y if y < low_y else low_y, y if y > high_y else high_y
    per_ray = np.float32(1 / (max(high_x - low_x, high_y - low_y) / across + 1e-9))
    cell = np.empty(len(points), np.int32)
    for i in range(len(points)):
        column, row = (rays[0, i] - low_x) * per_ray, (rays[1, i] - low_y) * per_ray
        column, row = column if column > zero else zero, row if row > zero else zero  # NaN too, of points without a ray
        column, row = column if column < last else last, row if row < last else last
        cell[i] = np.int32(row) * width + np.int32(column)
    return cell


@inner
def _below(n, stream):
    """A random integer from 0 to n - 1; ``stream`` (1,) uint64 goes on. SplitMix64 (Steele, Lea and Flood, "Fast
    splittable pseudorandom number generators", 2014), its upper half scaled."""
    stream[0] += np.uint64(0x9E3779B97F4A7C15)
    mixed = stream[0]
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed = mixed ^ (mixed >> np.uint64(31))
    return np.int64(((mixed >> np.uint64(32)) * np.uint64(n)) >> np.uint64(32))
