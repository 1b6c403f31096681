"""The object that stands on a table or floor, cut out of a cluttered frame by geometry alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

SAMPLES = 3000
"""Points on which planes are searched; all points are judged by the plane found."""
HYPOTHESES = 1000
COARSE, FINE = 0.01, 0.002
"""Thickness of a plane as a share of the distance: while searching, and at least when done (depth noise widens it)."""
MIN_SHARE = 0.1
"""A plane holds at least this share of the points."""
MAX_BEHIND = 0.02
"""A table, floor or wall has at most this share of all points behind it; an object's own faces have the table there."""
MAX_PLANES = 3
VOXEL = 0.02
"""Cluster resolution as a share of the median distance: parts nearer than about twice this are one object."""
RIVAL = 0.5
"""Another cluster with this share of the largest one's points makes the choice doubtful."""


@dataclass(frozen=True)
class Segment:
    """The largest thing in front of the supporting planes."""

    selected: np.ndarray
    """(N,) bool."""
    planes: np.ndarray
    """(P, 4) n and d of the planes n . p = d taken away, n towards the camera; empty where none was found."""
    rival: float
    """Size of the second largest cluster as a share of the largest."""


def segment_on_plane(points: np.ndarray) -> Segment:
    """Find tables, floors and walls in a camera-frame cloud (N, 3) and select the largest cluster in front of them.

    Deterministic: the same cloud gives the same answer.
    """
    rng = np.random.default_rng(0)
    distance = np.linalg.norm(points, axis=1)
    left = np.ones(len(points), dtype=bool)
    planes: list[np.ndarray] = []
    for _ in range(MAX_PLANES):
        plane = _find_plane(points, distance, left, rng)
        if plane is None:
            break
        height = points @ plane[:3] - plane[3]
        left &= height > _thickness(height, distance) * distance
        planes.append(plane)
    labels = _clusters(points[left])
    sizes = np.bincount(labels) if len(labels) else np.zeros(1, dtype=int)
    order = np.argsort(-sizes, kind="stable")
    selected = np.zeros(len(points), dtype=bool)
    selected[left] = labels == order[0]
    rival = float(sizes[order[1]] / sizes[order[0]]) if len(sizes) > 1 else 0.0
    return Segment(selected, np.array(planes).reshape(-1, 4), rival)


def _find_plane(
    points: np.ndarray, distance: np.ndarray, left: np.ndarray, rng: np.random.Generator
) -> np.ndarray | None:
    """(4,) the plane with most of the points ``left`` and hardly any of all points behind it, by RANSAC."""
    if left.sum() < 3:
        return None
    all_points = rng.choice(len(points), min(SAMPLES, len(points)), replace=False)
    candidates = rng.choice(np.nonzero(left)[0], (HYPOTHESES, 3))
    a, b, c = (points[candidates[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals, a = normals[length > 0] / length[length > 0, None], a[length > 0]
    offsets = np.einsum("hi,hi->h", normals, a)
    towards = np.where(offsets > 0, -1.0, 1.0)  # the camera is the origin: its height above the plane is -d
    normals, offsets = normals * towards[:, None], offsets * towards
    heights = (points[all_points] @ normals.T - offsets) / distance[all_points, None]
    on_plane = ((np.abs(heights) < COARSE) & left[all_points, None]).mean(0)
    behind = (heights < -2 * COARSE).mean(0)
    on_plane[behind > MAX_BEHIND] = 0.0
    if not len(on_plane) or on_plane.max() < MIN_SHARE:
        return None
    best = int(on_plane.argmax())
    plane = np.append(normals[best], offsets[best])
    for _ in range(3):
        height = points @ plane[:3] - plane[3]
        plane = _fit(points[left & (np.abs(height) < _thickness(height, distance) * distance)], plane)
    return plane


def _thickness(height: np.ndarray, distance: np.ndarray) -> float:
    """Half thickness of a plane, as a share of the distance, from the scatter of the points on it."""
    relative = np.abs(height) / distance
    relative = relative[relative < COARSE]
    sigma = 1.4826 * float(np.median(relative)) if len(relative) else 0.0
    return float(np.clip(3 * sigma, FINE, COARSE))


def _fit(points: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Least-squares plane (4,), normal on the side of ``before``'s."""
    if len(points) < 3:
        return before
    centre = points.mean(0)
    covariance = (points - centre).T @ (points - centre)
    normal = np.linalg.eigh(covariance)[1][:, 0]
    normal = normal if normal @ before[:3] > 0 else -normal
    return np.append(normal, normal @ centre)


def _clusters(points: np.ndarray) -> np.ndarray:
    """(N,) cluster index of every point: occupied voxels that touch are one cluster."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    size = VOXEL * float(np.median(np.linalg.norm(points, axis=1)))
    cells, cell_of = np.unique(np.floor(points / size).astype(np.int64), axis=0, return_inverse=True)
    pairs = KDTree(cells).query_pairs(1.8, output_type="ndarray")  # face, edge and corner neighbours
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    return connected_components(links, directed=False)[1][cell_of.ravel()]
