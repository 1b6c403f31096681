"""Directions that a part's own shape gives: where its flat faces look, where its tip points."""

import math

import numpy as np

from .mesh import Mesh, triangle_normals
from .rigid import across


def face_directions(mesh: Mesh, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two directions across ``axis`` that most of the surface faces or is parallel to, right-handed with it. Angles
    of face normals are taken modulo a quarter turn and the peak of their distribution by area is kept, so that hollow
    bodies, handles, rounded corners and noise do not tilt it."""
    first, second = across(axis)
    normals = triangle_normals(mesh.triangles)
    area = np.linalg.norm(normals, axis=1)
    x, y = normals @ first, normals @ second
    facing = np.hypot(x, y) > 0.9 * area
    quarter = math.pi / 2
    angle, weight = np.arctan2(y[facing], x[facing]) % quarter, area[facing]

    bins = 360
    histogram = np.bincount((angle / quarter * bins).astype(int) % bins, weight, bins)
    kernel = np.exp(-0.5 * (np.minimum(np.arange(bins), bins - np.arange(bins)) / 8) ** 2)  # sigma 2 degrees
    smooth = np.fft.irfft(np.fft.rfft(histogram) * np.fft.rfft(kernel), bins)
    peak = (smooth.argmax() + 0.5) * quarter / bins
    for _ in range(10):
        offset = (angle - peak + quarter / 2) % quarter - quarter / 2
        share = weight * (np.abs(offset) < math.radians(5))
        peak += float((share * offset).sum() / max(share.sum(), 1e-30))
    along = math.cos(peak) * first + math.sin(peak) * second
    return along, np.cross(axis, along)


def tip_direction(mesh: Mesh, axis: np.ndarray, pivot: np.ndarray) -> np.ndarray:
    """Unit vector across ``axis`` from ``pivot`` to the tip of a long part that crosses there: its slimmer end."""
    plane = np.stack(across(axis), 1)
    corners = (mesh.triangles - pivot) @ plane
    weight = np.repeat(np.linalg.norm(triangle_normals(mesh.triangles), axis=1), 3) + 1e-30
    points = ((corners + np.roll(corners, 1, 1)) / 2).reshape(-1, 2)  # second moments are exact at edges' middles
    long = np.linalg.eigh((points * weight[:, None]).T @ points)[1][:, 1]

    def spread(way: np.ndarray) -> float:
        side = points @ way > 0
        return float(np.linalg.eigvalsh(np.cov(points[side].T, aweights=weight[side]))[0]) if side.sum() > 2 else 0.0

    way = min((long, -long), key=spread)
    ends = (mesh.vertices - pivot) @ plane
    reach = np.linalg.norm(ends, axis=1) * (ends @ way > 0)
    tip = plane @ ends[reach > 0.98 * reach.max()].mean(0)
    return tip / np.linalg.norm(tip)
