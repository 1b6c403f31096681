"""Which points a network is shown. NumPy alone: a deployed program takes this file with it."""

import numpy as np

MASK = 2**64 - 1


def choose_points(points: np.ndarray, count: int, samples: int, seed: int, across: int) -> np.ndarray:
    """(samples, count) of points (N, 3): a random point of each of random cells, ``across`` of them along the image's
    longer side. SplitMix64 makes the random numbers."""
    cell = _cells(points, across)
    members, sizes = np.argsort(cell, kind="stable").tolist(), np.bincount(cell)
    starts, occupied = (np.cumsum(sizes) - sizes).tolist(), np.flatnonzero(sizes).tolist()
    chosen, state, cells = np.empty((samples, count), np.int64), seed, len(occupied)

    def below(n: int) -> int:
        nonlocal state
        state = (state + 0x9E3779B97F4A7C15) & MASK
        mixed = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & MASK
        return (((mixed ^ (mixed >> 31)) >> 32) * n) >> 32

    for sample in chosen:
        for k in range(min(count, cells)):
            other = k + below(cells - k)
            occupied[other], occupied[k] = occupied[k], occupied[other]
            sample[k] = members[starts[occupied[k]] + below(int(sizes[occupied[k]]))]
        for k in range(cells, count):
            sample[k] = sample[k - cells]
    return chosen


def _cells(points: np.ndarray, across: int) -> np.ndarray:
    """(N,) the image cell of each point."""
    with np.errstate(divide="ignore", invalid="ignore"):
        rays = points[:, :2] * (np.float32(1) / points[:, 2:])
        low, high = np.fmin.reduce(rays), np.fmax.reduce(rays)
        per_ray = np.float32(1 / (float((high - low).max()) / across + 1e-9))
        place = (rays - low) * per_ray
        place = np.where(place > 0, np.minimum(place, np.float32(across)), np.float32(0)).astype(np.int64)
    return place[:, 1] * (across + 1) + place[:, 0]
