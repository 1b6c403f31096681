"""Directions that a part's own shape gives: where its flat faces look, where its tip points."""

import math
from collections.abc import Sequence

import numpy as np

from .mesh import Mesh, triangle_normals
from .rigid import across

LEAST_PEAK = 0.2
"""Share of the most that faces look one way from which they count as facing that way at all."""
_BINS, _QUARTER = 360, math.pi / 2


def face_directions(mesh: Mesh, axis: np.ndarray, others: Sequence[Mesh] = ()) -> tuple[np.ndarray, np.ndarray]:
    """The two directions across ``axis`` that most of the surface faces or is parallel to, right-handed with it. Angles
    of face normals are taken modulo a quarter turn and the peak of their distribution by area is kept, so that hollow
    bodies, handles, rounded corners and noise do not tilt it. Of several peaks the one counts in which most of the
    surface of ``others``, too, faces: a bucket's walls slope, its bottom and its lid do not."""
    first, second = across(axis)
    angle, weight = _facing(mesh, axis, first, second)
    own = _smooth(angle, weight)
    total = own + sum(_smooth(*_facing(other, axis, first, second)) for other in others)
    peaks = (own >= np.roll(own, 1)) & (own >= np.roll(own, -1)) & (own >= LEAST_PEAK * own.max())
    peak = (np.where(peaks, total, -1.0).argmax() + 0.5) * _QUARTER / _BINS
    for _ in range(10):
        offset = (angle - peak + _QUARTER / 2) % _QUARTER - _QUARTER / 2
        share = weight * (np.abs(offset) < math.radians(5))
        peak += float((share * offset).sum() / max(share.sum(), 1e-30))
    along = math.cos(peak) * first + math.sin(peak) * second
    return along, np.cross(axis, along)


def _facing(mesh: Mesh, axis: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the faces that look across ``axis``, the angles, modulo a quarter turn, and the areas."""
    normals = triangle_normals(mesh.triangles)
    area = np.linalg.norm(normals, axis=1)
    x, y = normals @ first, normals @ second
    facing = np.hypot(x, y) > 0.9 * area
    return np.arctan2(y[facing], x[facing]) % _QUARTER, area[facing]


def _smooth(angle: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(_BINS,) how much faces each way, give or take 2 degrees."""
    histogram = np.bincount((angle / _QUARTER * _BINS).astype(int) % _BINS, weight, _BINS)
    kernel = np.exp(-0.5 * (np.minimum(np.arange(_BINS), _BINS - np.arange(_BINS)) / 8) ** 2)
    return np.fft.irfft(np.fft.rfft(histogram) * np.fft.rfft(kernel), _BINS)


def end_directions(mesh: Mesh, axis: np.ndarray, pivot: np.ndarray) -> tuple[tuple[np.ndarray, float], ...]:
    """The two ends of a long part that crosses at ``pivot``: each as the unit vector across ``axis`` that leads there
    from the pivot, with how wide the part is on that side (a length)."""
    plane = np.stack(across(axis), 1)
    corners = (mesh.triangles - pivot) @ plane
    weight = np.repeat(np.linalg.norm(triangle_normals(mesh.triangles), axis=1), 3) + 1e-30
    points = ((corners + np.roll(corners, 1, 1)) / 2).reshape(-1, 2)  # second moments are exact at edges' middles
    long = np.linalg.eigh((points * weight[:, None]).T @ points)[1][:, 1]
    ends = (mesh.vertices - pivot) @ plane

    def width(way: np.ndarray) -> float:
        side = points @ way > 0
        least = np.linalg.eigvalsh(np.cov(points[side].T, aweights=weight[side]))[0] if side.sum() > 2 else 0.0
        return math.sqrt(max(float(least), 0.0))

    def direction(way: np.ndarray) -> np.ndarray:
        reach = np.linalg.norm(ends, axis=1) * (ends @ way > 0)
        end = plane @ ends[reach > 0.98 * reach.max()].mean(0)
        return end / np.linalg.norm(end)

    return tuple((direction(way), width(way)) for way in (long, -long))
