"""Table, floor and walls: the large planes of a cloud that run behind whatever else there is."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from omad.common.compiled import jit
from omad.geometry.mesh import triangle_normals

from .cloud import CELLS, COARSE, FAR, FINE, Cloud, distances, some_of, thickness

SAMPLES = 3000
"""Points on which planes are searched; all points are judged by the plane found."""
HYPOTHESES = 1000
MIN_SHARE = 0.1
"""A table, floor or wall holds at least this share of the points."""
MAX_PLANES = 3
MAX_BEHIND = 0.02
"""A table, floor or wall has at most this share of all points behind it; an object's own faces have the table there.
What is ``FAR`` is behind nothing: a stray number of a camera, or what is seen through a door."""
MAX_COSINE = 0.5
"""Between the normals of two planes: walls are steep to the floor, and what is parallel to the table lies on it."""
AT_BORDER = 0.02
"""A wall has this share of its points at the frame's border: it runs out of the frame."""
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


def take_planes_away(cloud: Cloud) -> Before:
    """What of a cloud lies before table, floor and walls. Deterministic."""
    rng = np.random.default_rng(0)
    left = np.ones(len(cloud.scale), dtype=bool)
    planes: list[np.ndarray] = []
    lowest = 0.0
    for _ in range(MAX_PLANES):
        plane = find_plane(cloud, left, rng, partial(_steep, np.array(planes).reshape(-1, 4)))
        if plane is None:
            break
        height, half = cloud.heights(plane)
        on = left & (np.abs(height) < half)
        if planes and np.count_nonzero(cloud.at_border & on) < AT_BORDER * np.count_nonzero(on):
            break
        left &= height > half
        planes.append(plane)
        lowest = max(lowest, half * cloud.middle)
    if planes:
        left = _in_company(left, cloud.cell)
    return Before(left, np.array(planes).reshape(-1, 4), lowest)


def find_plane(
    cloud: Cloud,
    left: np.ndarray,
    rng: np.random.Generator,
    allows: Callable[[np.ndarray], np.ndarray],
    behind_at_most: float = MAX_BEHIND,
    share_at_least: float = MIN_SHARE,
) -> np.ndarray | None:
    """(4,) the plane with most of the points ``left`` (N,), these shares of all N points behind and on it, by
    RANSAC. ``allows`` says of unit normals (H, 3) towards the camera which may be its; None where there is no such
    plane."""
    candidates = np.flatnonzero(left)
    if len(candidates) < 3:
        return None
    sample = rng.choice(len(left), min(SAMPLES, len(left)), replace=False)
    corners = cloud.points.T[rng.choice(candidates, (HYPOTHESES, 3))].astype(np.float64)
    normals = triangle_normals(corners)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    offsets = np.einsum("hi,hi->h", normals, corners[:, 0])
    towards = np.where(offsets > 0, -1.0, 1.0)  # the camera is the origin: its height above the plane is -d
    planes = np.column_stack([normals, offsets]) * towards[:, None]

    points, scale = cloud.points.take(sample, 1), cloud.scale[sample]
    taken = np.where(left[sample], scale, 0)
    below = np.where(distances(points) < FAR * cloud.middle, -2 * COARSE * scale, -np.inf)
    on, close, behind = _votes(points, taken, below, planes.astype(np.float32)) / len(sample)
    allowed = (normals != 0).any(1) & (behind <= behind_at_most) & (on >= share_at_least) & allows(planes[:, :3])
    if not allowed.any():
        return None
    best = int(np.where(allowed, on + close, -np.inf).argmax())
    plane = planes[best]
    points, scale, left = some_of(cloud.points).astype(np.float64), some_of(cloud.scale), some_of(left)
    for _ in range(3):
        height = np.einsum("a,an->n", plane[:3], points) - plane[3]  # BLAS would wait for its threads
        height /= scale
        on_plane = np.flatnonzero(left & (np.abs(height) < thickness(height)))
        plane = _fit(points.take(on_plane, 1), plane)
    return plane


@jit
def _votes(points, taken, below, planes):
    """How many points (3, N) lie within ``COARSE`` of each plane (H, 4), how many within ``FINE``, and how many
    ``below`` (N,) it, (3, H); ``taken`` (N,) is what their heights are measured in, 0 of those that do not count as on
    it. Of the first those within twice that, but not within it, are subtracted: a plane that crosses a surface at a
    small angle has as many of these. The second tell it from one that is tilted to hold what lies flat on it, too."""
    votes = np.zeros((3, len(planes)))
    coarse, wide, fine = (
        (COARSE * taken).astype(np.float32),
        (2 * COARSE * taken).astype(np.float32),
        (FINE * taken).astype(np.float32),
    )
    for h in range(len(planes)):
        a, b, c, d = planes[h]
        on = near = close = behind = np.int32(0)  # as wide as what is compared: the loop takes several points at once
        for i in range(points.shape[1]):
            height = a * points[0, i] + b * points[1, i] + c * points[2, i] - d
            away = abs(height)
            on += np.int32(away < coarse[i])
            near += np.int32(away < wide[i])
            close += np.int32(away < fine[i])
            behind += np.int32(height < below[i])
        votes[0, h], votes[1, h], votes[2, h] = 2 * on - near, close, behind
    return votes


def _steep(planes: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(H,) bool, which unit normals (H, 3) are steep to all ``planes`` (P, 4)."""
    return np.abs(normals @ planes[:, :3].T).max(1, initial=0.0) < MAX_COSINE


def _fit(points: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Least-squares plane (4,) of points (3, N), normal on the side of ``before``'s."""
    if points.shape[1] < 3:
        return before
    centre = points.mean(1)
    points = points - centre[:, None]
    normal = np.linalg.eigh(np.einsum("an,bn->ab", points, points))[1][:, 0]
    return np.append(normal, normal @ centre) * (1 if normal @ before[:3] > 0 else -1)


def _in_company(left: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """(N,) bool, which of the points ``left`` (N,) have more than single ones of them around their image ``cell``."""
    side = CELLS + 1
    padded = np.pad(_counts(left, cell, side * side).reshape(2, side, side), ((0, 0), (1, 1), (1, 1)))
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    near, all_near = rows[..., :-2] + rows[..., 1:-1] + rows[..., 2:]
    return _of_cells(left, (near > ALONE * all_near).ravel(), cell)


@jit
def _counts(left, cell, cells):
    """(2, cells) how many of the points (N,) of each ``cell`` (N,) are ``left``, and how many there are."""
    counts = np.zeros((2, cells), dtype=np.int32)
    for i in range(len(cell)):
        counts[0, cell[i]] += left[i]
        counts[1, cell[i]] += 1
    return counts


@jit
def _of_cells(left, kept, cell):
    """(N,) bool, which of the points ``left`` (N,) have a ``cell`` (N,) of those ``kept``."""
    of_kept = np.empty_like(left)
    for i in range(len(left)):
        of_kept[i] = left[i] & kept[cell[i]]
    return of_kept
