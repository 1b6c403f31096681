"""The object that stands on a table or floor, cut out of a cluttered frame by geometry alone."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from omad.geometry.mesh import triangle_normals

SAMPLES = 3000
"""Points on which planes are searched; all points are judged by the plane found."""
HYPOTHESES = 1000
COARSE, FINE = 0.01, 0.002
"""Thickness of a plane as a share of the distance: while searching, and at least when done (depth noise widens it)."""
MIN_SHARE = 0.1
"""A table, floor or wall holds at least this share of the points."""
MAX_PLANES = 3
MAX_BEHIND = 0.02
"""A table, floor or wall has at most this share of all points behind it; an object's own faces have the table there."""
MAX_COSINE = 0.5
"""Between the normals of two planes: walls are steep to the floor, and what is parallel to the table lies on it."""
BORDER = 0.02
"""A wall has this share of its points this near to the frame's border: it runs out of the frame."""
CELLS = 160
"""Across the frame; heights over a plane are averaged inside such a cell, against the noise of single pixels."""
VOXEL = 0.02
"""Cluster resolution as a share of the median distance: what is nearer than about twice this is one thing."""
SPARSE = 0.1
"""Voxels with fewer points than this share of the median hold noise."""
GAP = 0.1
"""Clusters this near to the chosen one, as a share of its size, are parts of it."""
RIVAL = 0.5
"""Another cluster with this share of the chosen one's weight makes the choice doubtful."""


@dataclass(frozen=True)
class Segment:
    """The most prominent thing in front of the supporting planes."""

    selected: np.ndarray
    """(N,) bool."""
    planes: np.ndarray
    """(P, 4) n and d of the planes n . p = d taken away, n towards the camera; empty where none was found."""
    rival: float
    """Weight of the second cluster as a share of the chosen one's."""


def segment_on_plane(points: np.ndarray, inside: np.ndarray | None = None) -> Segment:
    """Find table, floor and walls in a camera-frame cloud (N, 3) and select the most prominent cluster before them.
    ``inside`` (N,) bool says where the object is looked for; the planes are found in the whole cloud. A cluster's
    weight is its squared size, more in the middle of the frame (or of what is inside) than at its border.
    Deterministic: the same cloud gives the same answer."""
    inside = np.ones(len(points), dtype=bool) if inside is None else inside
    rng = np.random.default_rng(0)
    distance = np.linalg.norm(points, axis=1)
    scale = distance**2 / np.median(distance)  # the errors of stereo grow with the square of the distance
    place = _place(points)
    to_border = (1 - np.abs(place)).min(1)
    cell = ((place + 1) * (CELLS / 2)).astype(np.int64) @ (1, CELLS + 1)
    left = np.ones(len(points), dtype=bool)
    planes: list[np.ndarray] = []
    for _ in range(MAX_PLANES):
        plane = _find_plane(points, scale, left, planes, rng)
        if plane is None:
            break
        height = _smoothed((points @ plane[:3] - plane[3]) / scale, cell)
        thickness = _thickness(height)
        if planes and (to_border[left & (np.abs(height) < thickness)] < BORDER).mean() < BORDER:
            break
        left &= height > thickness
        planes.append(plane)
    left &= inside
    central = np.zeros(len(points))
    central[inside] = (1 - np.abs(_place(points[inside]))).prod(1)
    chosen, rival = _prominent_cluster(points[left], central[left])
    left[left] = chosen
    return Segment(left, np.array(planes).reshape(-1, 4), rival)


def _find_plane(
    points: np.ndarray, scale: np.ndarray, left: np.ndarray, before: list[np.ndarray], rng: np.random.Generator
) -> np.ndarray | None:
    """(4,) the plane with most of the points ``left`` and hardly any of all points behind it, by RANSAC. It is steep to
    all planes found ``before``; None where there is no such plane."""
    if left.sum() < 3:
        return None
    sample = rng.choice(len(points), min(SAMPLES, len(points)), replace=False)
    corners = points[rng.choice(np.nonzero(left)[0], (HYPOTHESES, 3))]
    normals = triangle_normals(corners)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    offsets = np.einsum("hi,hi->h", normals, corners[:, 0])
    towards = np.where(offsets > 0, -1.0, 1.0)  # the camera is the origin: its height above the plane is -d
    normals, offsets = normals * towards[:, None], offsets * towards

    heights = (points[sample] @ normals.T - offsets) / scale[sample, None]
    share = ((np.abs(heights) < COARSE) & left[sample, None]).mean(0)
    allowed = (normals != 0).any(1) & ((heights < -2 * COARSE).mean(0) <= MAX_BEHIND)
    for other in before:
        allowed &= np.abs(normals @ other[:3]) < MAX_COSINE
    share[~allowed] = 0.0
    best = int(share.argmax())
    if share[best] < MIN_SHARE:
        return None
    plane = np.append(normals[best], offsets[best])
    for _ in range(3):
        height = (points @ plane[:3] - plane[3]) / scale
        plane = _fit(points[left & (np.abs(height) < _thickness(height))], plane)
    return plane


def _thickness(height: np.ndarray) -> float:
    """Half thickness of a plane, from the scatter of the points on it; all relative."""
    near = np.abs(height)[np.abs(height) < COARSE]
    sigma = 1.4826 * float(np.median(near)) if len(near) else 0.0
    return float(np.clip(3 * sigma, FINE, COARSE))


def _fit(points: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Least-squares plane (4,), normal on the side of ``before``'s."""
    if len(points) < 3:
        return before
    centre = points.mean(0)
    normal = np.linalg.eigh((points - centre).T @ (points - centre))[1][:, 0]
    return np.append(normal, normal @ centre) * (1 if normal @ before[:3] > 0 else -1)


def _smoothed(height: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Heights (N,) with those near the plane replaced by their mean over the image cell (N,)."""
    near = np.abs(height) < COARSE
    total = np.bincount(cell[near], height[near], minlength=cell.max() + 1)
    count = np.bincount(cell[near], minlength=cell.max() + 1)
    return np.where(near, (total / np.maximum(count, 1))[cell], height)


def _place(points: np.ndarray) -> np.ndarray:
    """(N, 2) place in the frame, -1 to 1; the frame is what all the points span."""
    if not len(points):
        return np.zeros((0, 2))
    ray = points[:, :2] / np.maximum(points[:, 2:], 1e-9)
    low, high = np.quantile(ray, 0.001, axis=0), np.quantile(ray, 0.999, axis=0)
    return np.clip((ray - low) / np.maximum(high - low, 1e-9) * 2 - 1, -1, 1)


def _prominent_cluster(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, float]:
    """(N,) bool of the heaviest cluster (touching voxels) with its outlying pieces, and the next one's share of it."""
    if not len(points):
        return np.zeros(0, dtype=bool), 0.0
    voxel = VOXEL * float(np.median(np.linalg.norm(points, axis=1)))
    cells = np.floor(points / voxel).astype(np.int64)
    cells, cell_of, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    cell_of = cell_of.ravel()
    dense = count >= SPARSE * np.median(count[cell_of])
    pairs = KDTree(cells).query_pairs(1.8, output_type="ndarray")  # face, edge and corner neighbours
    pairs = pairs[dense[pairs].all(1)]
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(cells), len(cells)))
    labels = connected_components(links, directed=False)[1]
    # size counts, not points: glasses seen from their edge are as much a thing as the box beside them
    central = np.bincount(labels[cell_of], weights * dense[cell_of])
    central /= np.maximum(np.bincount(labels[cell_of], dense[cell_of]), 1)
    low, high = np.tile([[[cells.max()]], [[cells.min()]]], (1, len(central), 3))
    np.minimum.at(low, labels, cells)
    np.maximum.at(high, labels, cells)
    weight = central * np.square(high - low + 1.0).sum(1)
    best = int(weight.argmax())

    core = cells[labels == best]
    reach = max(GAP * float(np.linalg.norm(np.ptp(core, axis=0))), 1.8)
    distance, _ = KDTree(core).query(cells, distance_upper_bound=reach)
    near = np.unique(labels[dense & np.isfinite(distance)])
    weight[near] = np.where(near == best, weight[near], 0.0)
    rival = float(np.delete(weight, best).max(initial=0.0) / max(weight[best], 1e-300))
    return (np.isin(labels, near) & dense)[cell_of], rival
