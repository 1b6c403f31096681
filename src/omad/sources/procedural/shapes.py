"""Closed, outward-oriented solids for the procedural generators. Lengths in metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...objects import Mesh


def loft(rings: np.ndarray) -> Mesh:
    """Solid through a stack of rings (L, n, 3), each star-shaped about its mean; both ends are closed."""
    levels, n, _ = rings.shape
    vertices = np.concatenate([rings.reshape(-1, 3), rings[0].mean(0)[None], rings[-1].mean(0)[None]])
    index = np.arange(n)
    following = (index + 1) % n
    faces = []
    for level in range(levels - 1):
        a, b = level * n + index, level * n + following
        faces += [np.stack([a, b, b + n], 1), np.stack([a, b + n, a + n], 1)]
    bottom, top = levels * n, levels * n + 1
    last = (levels - 1) * n
    faces.append(np.stack([following, index, np.full(n, bottom)], 1))
    faces.append(np.stack([last + index, last + following, np.full(n, top)], 1))
    return _outward(vertices, np.concatenate(faces))


def hexahedron(corners: np.ndarray) -> Mesh:
    """Solid with eight corners (8, 3): a ring of four, then the ring opposite."""
    side = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
    ends = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    return _outward(corners, np.array(side + ends))


def box(low: Sequence[float], high: Sequence[float]) -> Mesh:
    """Axis-aligned box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = np.array([[x0, 0, z0], [x1, 0, z0], [x1, 0, z1], [x0, 0, z1]])
    return hexahedron(np.concatenate([ring + [0, y0, 0], ring + [0, y1, 0]]))


def rounded_rectangle(width: float, height: float, radius: float, segments: int = 4) -> np.ndarray:
    """Outline (n, 2) counter-clockwise, centred on the origin."""
    radius = float(np.clip(radius, 1e-4, 0.49 * min(width, height)))
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    points = []
    for quarter, (sx, sy) in enumerate(corners):
        angles = np.linspace(quarter, quarter + 1, segments + 1) * np.pi / 2
        centre = np.array([sx * (width / 2 - radius), sy * (height / 2 - radius)])
        points.append(centre + radius * np.stack([np.cos(angles), np.sin(angles)], 1))
    return np.concatenate(points)


def slab(
    low: Sequence[float],
    high: Sequence[float],
    axis: int,
    radius: float,
    bevel: float = 0.0,
    segments: int = 3,
) -> Mesh:
    """Box whose four edges along ``axis`` are rounded by ``radius`` and whose two faces across it are bevelled."""
    lo, hi = np.asarray(low, float), np.asarray(high, float)
    first, second = [a for a in range(3) if a != axis]
    size, centre = hi - lo, (lo + hi) / 2
    bevel = float(np.clip(bevel, 0.0, 0.45 * size[axis]))
    levels = [(lo[axis], bevel), (lo[axis] + bevel, 0.0), (hi[axis] - bevel, 0.0), (hi[axis], bevel)]
    if bevel == 0:
        levels = [levels[0], levels[-1]]
    rings = []
    for height, inset in levels:
        outline = rounded_rectangle(size[first] - 2 * inset, size[second] - 2 * inset, radius, segments)
        ring = np.empty((len(outline), 3))
        ring[:, first], ring[:, second], ring[:, axis] = *(outline + centre[[first, second]]).T, height
        rings.append(ring)
    return loft(np.stack(rings))


def cylinder(start: Sequence[float], end: Sequence[float], radius: float, segments: int = 10) -> Mesh:
    """Round bar from ``start`` to ``end``."""
    return tube(np.array([start, end], float), radius, segments)


def tube(path: np.ndarray, radius: float, segments: int = 10) -> Mesh:
    """Round bar along a path (L, 3) that lies in a plane and does not turn back on itself."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(path[-1] - path[0], path[len(path) // 2] - path[0])
    if np.linalg.norm(across) < 1e-9:  # straight: any normal will do
        across = np.cross(along[0], np.eye(3)[np.abs(along[0]).argmin()])
    across /= np.linalg.norm(across)
    up = np.cross(along, across)[:, None]
    angle = (np.arange(segments) * 2 * np.pi / segments)[:, None]
    return loft(path[:, None] + radius * (np.cos(angle) * across + np.sin(angle) * up))


def warp(mesh: Mesh, move) -> Mesh:
    """The mesh with its vertices (V, 3) mapped by ``move``."""
    return Mesh(move(mesh.vertices), mesh.faces)


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """All solids as one mesh; each stays closed by itself."""
    offsets = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + offset for m, offset in zip(meshes, offsets, strict=True)]),
    )


def _outward(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    corner = vertices[faces]
    volume = np.einsum("fi,fi->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))
    return Mesh(vertices, faces if volume > 0 else faces[:, ::-1])
