"""Outlines of things on a floor or table: how far they reach in its plane."""

import numpy as np

from omad.common.compiled import jit

UP = 0.25
"""Cosine between the image's up and the normal of a table or floor, at least; fronts of cabinets look to the camera or
down."""
PARALLEL = 0.97
"""Cosine between the normals of a table and its floor, at least."""
DIRECTIONS = np.stack([function(np.arange(16) * (np.pi / 8)) for function in (np.cos, np.sin)], 1).astype(np.float32)
"""(16, 2) in a plane; how far something reaches in each is its outline."""


def width_of(outline: np.ndarray) -> np.ndarray:
    """(8,) of an outline (16,), from each direction to the opposite one."""
    return outline[:8] + outline[8:]


def axes_of(plane: np.ndarray) -> np.ndarray:
    """(2, 3) float32 directions that span a plane (4,)."""
    return np.linalg.svd(plane[None, :3])[2][1:].astype(np.float32)


@jit
def outline_of(axes, points, index):
    """(16,) how far points (3, N), by their ``index`` (M,), reach in DIRECTIONS in the plane of ``axes`` (2, 3)."""
    outline = np.full(len(DIRECTIONS), -np.inf, dtype=np.float32)
    for i in index:
        across = axes[0, 0] * points[0, i] + axes[0, 1] * points[1, i] + axes[0, 2] * points[2, i]
        along = axes[1, 0] * points[0, i] + axes[1, 1] * points[1, i] + axes[1, 2] * points[2, i]
        for k in range(len(outline)):
            outline[k] = max(outline[k], DIRECTIONS[k, 0] * across + DIRECTIONS[k, 1] * along)
    return outline


@jit
def within(outline, axes, points):
    """(N,) bool, which of points (3, N) lie over, on or under what has an outline (16,) in the plane of ``axes``
    (2, 3)."""
    inside = np.empty(points.shape[1], dtype=np.bool_)
    (a, b, c), (d, e, f) = axes
    for i in range(len(inside)):
        x, y, z = points[0, i], points[1, i], points[2, i]
        across, along = a * x + b * y + c * z, d * x + e * y + f * z
        inside_all = True
        for k in range(8):  # all of them: the loop takes several points at once
            reach = DIRECTIONS[k, 0] * across + DIRECTIONS[k, 1] * along
            inside_all &= (reach <= outline[k]) & (-reach <= outline[k + 8])  # that of the opposite direction
        inside[i] = inside_all
    return inside
