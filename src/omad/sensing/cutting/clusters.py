"""Things in a cloud: points whose voxels touch."""

from dataclasses import dataclass
from itertools import product
from typing import Self

import numpy as np
from scipy.spatial import KDTree

from omad.common.compiled import jit
from omad.geometry.disjoint_sets import join, numbered
from omad.geometry.rigid import diagonal

from .cloud import distances

VOXEL = 0.02
"""Cluster resolution as a share of the median distance: what is nearer than about twice this is one thing."""
SPARSE = 0.1
"""Voxels with fewer points than this share of the median hold noise."""
GAP = 0.1
"""Clusters this near to the chosen one, as a share of its size, are parts of it."""
FINE = 0.012
"""As VOXEL, where all things are wanted: neighbours are not to be run together, and pieces find their thing anyway."""
PIECE = 0.4
"""What is smaller than this share of a thing and near to it is a piece of it."""


def prominent_cluster(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, float]:
    """(N,) bool of the heaviest cluster with its outlying pieces, and the next one's weight as a share of its own, in
    a cloud (3, N) in the camera frame. A cluster's weight is its squared size times the mean of its points'
    ``weights``."""
    if not points.size:
        return np.zeros(0, dtype=bool), 0.0
    voxels = _Voxels.of(points, VOXEL)
    cells, cell_of = voxels.cells, voxels.cell_of
    count = np.bincount(cell_of)
    dense = count >= SPARSE * np.median(count[cell_of])
    labels = _touching(voxels.keys, voxels.steps, dense)
    # size counts, not points: glasses seen from their edge are as much a thing as the box beside them
    central = np.bincount(labels, np.bincount(cell_of, weights) * dense)
    central /= np.maximum(np.bincount(labels, count * dense), 1)
    weight = central * np.square(_extents(cells, labels) + 1.0).sum(1)
    best = int(weight.argmax())

    core = cells[labels == best]
    reach = max(GAP * diagonal(core), 1.8)
    others = np.flatnonzero(dense & (labels != best))
    pieces = np.unique(labels[others[_near(core, cells[others], reach)]])
    weight[pieces] = 0.0
    rival = float(np.delete(weight, best).max(initial=0.0) / max(weight[best], 1e-300))
    return (np.isin(labels, [best, *pieces]) & dense)[cell_of], rival


def all_clusters(points: np.ndarray, least: int) -> list[np.ndarray]:
    """Indices of the points of every thing of at least ``least`` points, the largest first, in a cloud (3, N) in the
    camera frame. What is near to something much larger belongs to that."""
    if not points.size:
        return []
    voxels = _Voxels.of(points, FINE)
    count = np.bincount(voxels.cell_of)
    dense = count >= SPARSE * np.median(count[voxels.cell_of])
    labels = _touching(voxels.keys, voxels.steps, dense)
    kept = dense & (np.bincount(labels, count)[labels] >= least / 10)
    size = np.zeros(labels.max() + 1)
    held = np.unique(labels[kept])
    size[held] = np.linalg.norm(_extents(voxels.cells, labels)[held] + 1.0, axis=1)
    owner = np.full(len(size), -1)
    for core in np.argsort(-size, kind="stable")[: np.count_nonzero(size)]:
        if owner[core] >= 0:
            continue
        owner[core] = core
        others = np.flatnonzero(kept & (owner[labels] < 0) & (size[labels] < PIECE * size[core]))
        of_core, reach = voxels.cells[kept & (labels == core)], max(GAP * float(size[core]), 1.8)
        owner[labels[others[_near(of_core, voxels.cells[others], reach)]]] = core
    of_point = np.where(kept, owner[labels], -1)[voxels.cell_of]
    things = [np.flatnonzero(of_point == core) for core in np.flatnonzero(owner == np.arange(len(owner)))]
    return sorted((thing for thing in things if len(thing) >= least), key=len, reverse=True)


def _near(core: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    """(M,) bool, which of the cells ``others`` (M, 3) are less than ``reach`` from one of the ``core`` (V, 3). Most lie
    far beside all of it, and few of the core beside those that do not."""
    near = _between(others, core, reach)
    if near.any():
        tree = KDTree(core[_between(core, others[near], reach)])
        near[near] = np.isfinite(tree.query(others[near], distance_upper_bound=reach)[0])
    return near


def _between(cells: np.ndarray, others: np.ndarray, reach: float) -> np.ndarray:
    """(V,) bool, which ``cells`` (V, 3) are at most ``reach`` beside the box around ``others`` (M, 3)."""
    return ((cells >= others.min(0) - reach) & (cells <= others.max(0) + reach)).all(1)


def _extents(cells: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(L, 3) how far the ``cells`` (V, 3) of each of L ``labels`` (V,) reach along the axes."""
    low, high = np.tile([[[cells.max()]], [[cells.min()]]], (1, labels.max() + 1, 3))
    _widen(low, high, cells, labels)
    return high - low


@jit
def _widen(low, high, cells, labels):
    """Move the bounds (L, 3) of each label to those of its ``cells`` (V, 3)."""
    for i in range(len(labels)):
        for axis in range(3):
            low[labels[i], axis] = min(low[labels[i], axis], cells[i, axis])
            high[labels[i], axis] = max(high[labels[i], axis], cells[i, axis])


@dataclass(frozen=True)
class _Voxels:
    """The V voxels that hold points, by their keys: numbers in the order of x, then y, then z."""

    cells: np.ndarray
    """(V, 3) int64."""
    cell_of: np.ndarray
    """(N,) the voxel each point is in."""
    keys: np.ndarray
    """(V,) int64, ascending."""
    steps: np.ndarray
    """(13,) from a voxel's key to those of its face, edge and corner neighbours with greater keys."""

    @classmethod
    def of(cls, points: np.ndarray, resolution: float) -> Self:
        """Of points (3, N), ``resolution`` is the voxels' edge as a share of their median distance. Only where a row of
        pixels goes from one voxel into the next is anything sorted."""
        cell = np.floor(points / (resolution * float(np.median(distances(points))))).astype(np.int64)
        cell -= cell.min(1, keepdims=True)
        width, depth = cell[1:].max(1) + 2  # with an empty one beside the last: a step never leads into the next row
        along = np.array([width * depth, depth, 1])
        key = along @ cell
        starts = np.flatnonzero(np.diff(key, prepend=-1))
        keys, first, of_run = np.unique(key[starts], return_index=True, return_inverse=True)
        steps = np.array(list(product((-1, 0, 1), repeat=3))) @ along
        cell_of = np.repeat(of_run, np.diff(starts, append=len(key)))
        return cls(cell.T[starts[first]], cell_of, keys, steps[steps > 0])


@jit
def _touching(keys, steps, dense):
    """(V,) number of the thing each voxel belongs to: those that are dense and touch have the same one."""
    root = np.arange(len(keys))
    for step in steps:
        other = 0
        for i in range(len(keys)):
            while other < len(keys) and keys[other] < keys[i] + step:
                other += 1
            if other < len(keys) and keys[other] == keys[i] + step and dense[i] and dense[other]:
                join(root, i, other)
    return numbered(root)
