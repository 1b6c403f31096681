"""The nearest of few points for each of many, in compiled loops: the few lie in a grid of cells."""

import math

import numpy as np

from omad.common.arrays import for_loops
from omad.common.compiled import jit
from omad.geometry.rigid import box

CELLS = 24
"""Across the longest side of the box of the few; they lie on surfaces, some two to a cell that is not empty."""


def nearest(points: np.ndarray, few: np.ndarray) -> np.ndarray:
    """Index (N,) of the point of ``few`` (n, 3) that is nearest to each of ``points`` (N, 3); both finite float32, and
    ``points`` best in the order of the image."""
    low, high = box(few).astype(np.float64)
    size = max(float((high - low).max()) / CELLS, 1e-9)
    shape = np.floor((high - low) / size).astype(np.int64) + 1
    cells = np.ravel_multi_index(tuple(np.floor((few - low) / size).astype(np.int64).T), tuple(shape))
    order = np.argsort(cells, kind="stable")
    starts = np.cumsum(np.bincount(cells + 1, minlength=shape.prod() + 1))
    return order[_search(for_loops(points), few[order].astype(np.float64), low, size, shape, starts)]


@jit
def _search(points, few, low, size, shape, starts):
    """The same in ``few`` that are sorted by cell: those of cell c are ``starts[c]`` to ``starts[c + 1]``."""
    found, guess = np.empty(len(points), np.int64), 0
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for o in range(len(points)):
        x, y, z = points[o, 0], points[o, 1], points[o, 2]  # mostly the neighbour in the image of the one before
        best = (few[guess, 0] - x) ** 2 + (few[guess, 1] - y) ** 2 + (few[guess, 2] - z) ** 2
        radius, reach = -1.0, size
        while math.sqrt(best) > radius:
            radius = min(math.sqrt(best), reach)
            for i in range(3):
                first[i] = min(max(math.floor((points[o, i] - radius - low[i]) / size), 0), shape[i] - 1)
                last[i] = min(max(math.floor((points[o, i] + radius - low[i]) / size), 0), shape[i] - 1)
            for a in range(first[0], last[0] + 1):
                for b in range(first[1], last[1] + 1):
                    row = (a * shape[1] + b) * shape[2]
                    for k in range(starts[row + first[2]], starts[row + last[2] + 1]):
                        squared = (few[k, 0] - x) ** 2 + (few[k, 1] - y) ** 2 + (few[k, 2] - z) ** 2
                        if squared < best:
                            best, guess = squared, k
            reach *= 2.0
        found[o] = guess
    return found
