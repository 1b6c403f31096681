"""Pieces of one thing that fell apart in depth, as a dishwasher's door, racks and top do where nothing that is seen
leads from one to the other: what hangs in the air over the place of another thing is held by it."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from omad.geometry.rigid import diagonal

from .cloud import Cloud
from .footprints import PARALLEL, UP, axes_of, outline_of

BESIDE = 0.02
"""The outlines of two pieces of a thing overlap, or are so near to each other, as a share of its size."""
IN_THE_AIR = 0.05
"""One of two pieces is this share of the size over what the other one may stand on, at least."""
HELD = 0.4
"""They are no farther from each other than this share of the size."""
STRAY = 0.02
"""Share of a thing's points that may be noise below it."""
FEW = 1000
"""Points of a thing, at most, that tell how far others are."""


def joined(cloud: Cloud, things: Sequence[np.ndarray], planes: np.ndarray) -> list[np.ndarray]:
    """Things, by the indices of their points in a cloud, the pieces of each in one; the largest first. Where none of
    the ``planes`` (P, 4) before which they stand is level in an image held upright, nothing is joined."""
    level = planes[planes[:, 1] < -UP]
    if not len(level) or len(things) < 2:
        return list(things)
    level = level[level[:, :3] @ level[0, :3] > PARALLEL]
    axes = axes_of(level[0])
    outlines = np.array([outline_of(axes, cloud.points, thing) for thing in things])
    few = [cloud.points.take(thing[:: -(-len(thing) // FEW)], 1) for thing in things]
    lows = np.array([_low(points, level) for points in few])
    sizes = np.array([diagonal(points.T) for points in few])
    size = np.maximum.outer(sizes, sizes)
    over = (outlines[:, None] + np.roll(outlines, 8, axis=1)).min(-1) > -BESIDE * size
    held = np.triu(over & (np.maximum.outer(lows, lows) > IN_THE_AIR * size), 1)
    for i, j in np.argwhere(held).tolist():
        apart = KDTree(few[i].T).query(few[j].T, distance_upper_bound=float(HELD * size[i, j]))[0]
        held[i, j] = np.isfinite(apart).any()
    count, of_thing = connected_components(held)
    whole = [np.concatenate([things[i] for i in np.flatnonzero(of_thing == n).tolist()]) for n in range(count)]
    return sorted(map(np.sort, whole), key=len, reverse=True)


def _low(points: np.ndarray, level: np.ndarray) -> float:
    """Metres from the lowest of points (3, N), but for stray ones, to the nearest of the planes (P, 4)."""
    return float(np.abs(np.quantile(level[:, :3] @ points - level[:, 3:], STRAY, axis=1)).min())
