"""Rigid transforms of NumPy arrays: ``transforms`` has their kin for batches of tensors. ``T_a_b`` is a 4x4 matrix that
takes coordinates in frame b to coordinates in frame a."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from omad.common.arrays import numbers
from omad.common.errors import InputError

from .transforms import MIRROR_X

LONG = 256
"""Points that ``box`` takes together."""


def rigid(rotation: np.ndarray, translation: np.ndarray | Sequence[float]) -> np.ndarray:
    """(4, 4) of a rotation (3, 3) and a translation (3,)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, translation
    return T


def turned_about(rotation: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(4, 4) the rotation (3, 3) that leaves ``point`` (3,) where it is."""
    return rigid(rotation, point - rotation @ point)


def mirrored(T: np.ndarray) -> np.ndarray:
    """Transforms (..., 4, 4) as they are in a mirror in the plane x = 0 of both of their frames: where T takes a thing,
    its image is taken. A rigid one stays one."""
    sign = np.array([*MIRROR_X, 1.0])
    return sign[:, None] * T * sign


def carry(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) by T (4, 4)."""
    return points @ T[:3, :3].T + T[:3, 3]


def carry_each(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (N, 3), each by its own transform (N, 4, 4): ``T[part_of]``, say."""
    return rotate_each(T, points) + T[:, :3, 3]


def rotate_each(T: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Directions (N, 3), each by the rotation of its own transform (N, 4, 4)."""
    return (T[:, :3, :3] @ vectors[..., None])[..., 0]


def is_rotation(matrix: np.ndarray) -> bool:
    """Whether (3, 3) turns and does nothing else, to 1e-3: no reflection either."""
    turns = np.isfinite(matrix).all() and np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3)
    return bool(turns and np.linalg.det(matrix) > 0)


def is_rigid(T: np.ndarray) -> bool:
    """Whether (4, 4) is a rotation and a translation."""
    return bool(np.isfinite(T).all() and np.allclose(T[3], [0, 0, 0, 1])) and is_rotation(T[:3, :3])


def rigid_transform(values: Any, what: str) -> np.ndarray:
    """(4, 4) float64 of whatever a caller has. Raises InputError, which begins with ``what``, where it is no rotation
    and translation."""
    T = numbers(values, 4, 4, what=what)
    if not is_rigid(T):
        raise InputError(f"{what}: is no rotation and translation; correct it")
    return T


def across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to a unit ``axis`` (3,), right-handed with it; which ones is arbitrary."""
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def split(vector: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What of a vector (3,) is along a unit ``axis`` (3,), and what is across it."""
    along = axis * (axis @ vector)
    return along, vector - along


def unit(vector: np.ndarray) -> np.ndarray:
    """Of length 1."""
    return vector / np.linalg.norm(vector)


def box(points: np.ndarray) -> np.ndarray:
    """(2, D) low and high corner of the axis-aligned box of points (N, D)."""
    # NumPy reduces few long rows fifty times as fast as many short ones
    if whole := len(points) // LONG * LONG:
        rows, width = points[:whole].reshape(whole // LONG, -1), points.shape[1]
        ends = np.concatenate([rows.min(0), rows.max(0)]).reshape(-1, width)
        points = np.concatenate([ends, points[whole:]])
    columns = np.ascontiguousarray(points.T)
    return np.stack([columns.min(1), columns.max(1)])


def diagonal(points: np.ndarray) -> float:
    """Length of that of the box of points (N, D)."""
    return float(np.linalg.norm(np.subtract(*box(points))))


def bounding_sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) of the box of points (N, 3), and how far the farthest of them is from it."""
    centre = box(points).sum(0) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())
