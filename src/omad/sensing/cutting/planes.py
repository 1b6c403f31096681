"""Table, floor and walls: the large planes of a cloud that run behind whatever else there is."""

from dataclasses import dataclass

import numpy as np

from omad.common.compiled import jit
from omad.geometry.mesh import triangle_normals

SAMPLES = 3000
"""Points on which planes are searched; all points are judged by the plane found."""
HYPOTHESES = 1000
ENOUGH = 40_000
"""Points, at most, for what is the same with more of them: a plane fitted to them, the median of their distances."""
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
ALONE = 0.12
"""What is no more than this share of all points in its cell and the cells around it is noise of the plane."""


@dataclass(frozen=True)
class Before:
    """What of a cloud of N points lies before its large planes."""

    left: np.ndarray
    """(N,) bool."""
    planes: np.ndarray
    """(P, 4) n and d of the planes n . p = d taken away, n towards the camera; empty where none was found."""
    lowest: float
    """Metres, at the middle distance: what rises less over a plane was taken away with it. 0 where there is none."""


def take_planes_away(points: np.ndarray, distance: np.ndarray, place: np.ndarray) -> Before:
    """Of points (3, N) and their ``distance`` (N,) from the camera, float32; ``place`` (2, N) is where they are in the
    frame, -1 to 1. Deterministic."""
    rng = np.random.default_rng(0)
    middle = float(np.median(some_of(distance)))
    scale = distance**2 / middle  # the errors of stereo grow with the square of the distance
    row, column = ((place + 1) * (CELLS / 2)).astype(np.int32)
    cell = row * (CELLS + 1) + column
    at_border = np.abs(place).max(0) > 1 - BORDER
    left = np.ones(len(distance), dtype=bool)
    planes: list[np.ndarray] = []
    lowest = 0.0
    for _ in range(MAX_PLANES):
        plane = _find_plane(points, scale, left, planes, rng)
        if plane is None:
            break
        normal, offset = np.split(plane.astype(np.float32), [3])
        height = (normal @ points - offset) / scale
        _smooth(height, cell, COARSE)
        thickness = _thickness(height)
        on = left & (np.abs(height) < thickness)
        if planes and np.count_nonzero(at_border & on) < BORDER * np.count_nonzero(on):
            break
        left &= height > thickness
        planes.append(plane)
        lowest = max(lowest, thickness * middle)
    if planes:
        left &= _in_company(left, cell)
    return Before(left, np.array(planes).reshape(-1, 4), lowest)


def some_of(values: np.ndarray) -> np.ndarray:
    """At most ``ENOUGH`` of values (..., N), evenly. An odd step meets all columns of most images."""
    return values[..., :: -(-values.shape[-1] // ENOUGH) | 1]


def _find_plane(
    points: np.ndarray, scale: np.ndarray, left: np.ndarray, before: list[np.ndarray], rng: np.random.Generator
) -> np.ndarray | None:
    """(4,) the plane with most of the points ``left`` and hardly any of all points behind it, by RANSAC. It is steep to
    all planes found ``before``; None where there is no such plane."""
    candidates = np.flatnonzero(left)
    if len(candidates) < 3:
        return None
    sample = rng.choice(len(left), min(SAMPLES, len(left)), replace=False)
    corners = points.T[rng.choice(candidates, (HYPOTHESES, 3))].astype(np.float64)
    normals = triangle_normals(corners)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    offsets = np.einsum("hi,hi->h", normals, corners[:, 0])
    towards = np.where(offsets > 0, -1.0, 1.0)  # the camera is the origin: its height above the plane is -d
    planes = np.column_stack([normals, offsets]) * towards[:, None]

    thickness = COARSE * scale[sample]
    near, below = np.where(left[sample], thickness, 0), -2 * thickness
    on, behind = _votes(points.take(sample, 1), near, below, planes.astype(np.float32))
    share = on / len(sample)
    allowed = (normals != 0).any(1) & (behind <= MAX_BEHIND * len(sample))
    for other in before:
        allowed &= np.abs(normals @ other[:3]) < MAX_COSINE
    share[~allowed] = 0.0
    best = int(share.argmax())
    if share[best] < MIN_SHARE:
        return None
    plane = planes[best]
    points, scale, left = some_of(points).astype(np.float64), some_of(scale), some_of(left)
    for _ in range(3):
        height = (plane[:3] @ points - plane[3]) / scale
        on_plane = np.flatnonzero(left & (np.abs(height) < _thickness(height)))
        plane = _fit(points.take(on_plane, 1), plane)
    return plane


@jit
def _votes(points, near, below, planes):
    """How many of the points (3, N) lie within ``near`` (N,) of each plane (H, 4), and how many ``below`` (N,) it, two
    (H,)."""
    on, behind = np.empty(len(planes)), np.empty(len(planes))
    for h in range(len(planes)):
        on_h, behind_h = 0, 0
        for i in range(points.shape[1]):
            height = planes[h, 0] * points[0, i] + planes[h, 1] * points[1, i] + planes[h, 2] * points[2, i]
            height -= planes[h, 3]
            on_h += abs(height) < near[i]
            behind_h += height < below[i]
        on[h], behind[h] = on_h, behind_h
    return on, behind


def _thickness(height: np.ndarray) -> float:
    """Half thickness of a plane, from the scatter of the points on it; all relative."""
    height = np.abs(height)
    near = height[height < COARSE]
    sigma = 1.4826 * float(np.median(near)) if len(near) else 0.0
    return float(np.clip(3 * sigma, FINE, COARSE))


def _fit(points: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Least-squares plane (4,) of points (3, N), normal on the side of ``before``'s."""
    if points.shape[1] < 3:
        return before
    centre = points.mean(1)
    points = points - centre[:, None]
    normal = np.linalg.eigh(points @ points.T)[1][:, 0]
    return np.append(normal, normal @ centre) * (1 if normal @ before[:3] > 0 else -1)


def _in_company(left: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """(N,) bool, whether around a point's image ``cell`` (N,) more than single ones of the points are ``left``."""
    side = CELLS + 1
    count = np.stack([np.bincount(cell, weight, side * side).reshape(side, side) for weight in (left, None)])
    padded = np.pad(count, ((0, 0), (1, 1), (1, 1)))
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    near, all_near = rows[..., :-2] + rows[..., 1:-1] + rows[..., 2:]
    return (near > ALONE * all_near).ravel()[cell]


@jit
def _smooth(height, cell, near):
    """Replace the heights (N,) within ``near`` by their mean over the image cell (N,)."""
    total, count = np.zeros(cell.max() + 1), np.zeros(cell.max() + 1)
    for i in range(len(height)):
        if abs(height[i]) < near:
            total[cell[i]] += height[i]
            count[cell[i]] += 1
    for i in range(len(height)):
        if abs(height[i]) < near:
            height[i] = total[cell[i]] / count[cell[i]]
