"""Closed, outward-oriented solids for the procedural generators. Lengths in metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from ...objects import Mesh


def loft(rings: np.ndarray, closed: bool = False) -> Mesh:
    """Solid through a stack of rings (L, n, 3); ``closed``: the last joins the first.

    Otherwise both ends are capped, and the end rings must be star-shaped about their means.
    """
    levels, n, _ = rings.shape
    index = np.arange(n)
    following = (index + 1) % n
    faces = []
    for level in range(levels if closed else levels - 1):
        a, b = level * n, (level + 1) % levels * n
        faces += [np.stack([a + index, a + following, b + following], 1)]
        faces += [np.stack([a + index, b + following, b + index], 1)]
    vertices = rings.reshape(-1, 3)
    if not closed:
        last, bottom, top = (levels - 1) * n, levels * n, levels * n + 1
        faces.append(np.stack([following, index, np.full(n, bottom)], 1))
        faces.append(np.stack([last + index, last + following, np.full(n, top)], 1))
        vertices = np.concatenate([vertices, rings[0].mean(0)[None], rings[-1].mean(0)[None]])
    return _outward(vertices, np.concatenate(faces))


def hexahedron(corners: np.ndarray) -> Mesh:
    """Solid with eight corners (8, 3): a ring of four, then the ring opposite."""
    side = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
    ends = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    return _outward(corners, np.array(side + ends))


def box(low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray) -> Mesh:
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
    across = np.cross(path[-1] - path[0], path[len(path) // 2] - path[0])
    if np.linalg.norm(across) < 1e-9:  # straight: any normal will do
        along = path[-1] - path[0]
        across = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    return sweep(path, across, ellipse(radius, radius, segments))


def ellipse(a: float, b: float, segments: int = 10) -> np.ndarray:
    """Outline (n, 2) counter-clockwise with semi-axes ``a`` and ``b``."""
    angle = np.arange(segments) * 2 * np.pi / segments
    return np.stack([a * np.cos(angle), b * np.sin(angle)], 1)


def sweep(path: np.ndarray, normal: np.ndarray, section: np.ndarray, closed: bool = False) -> Mesh:
    """Solid along a path (L, 3), open or a loop, with a cross-section (n, 2) or one a point of the path (L, n, 2).

    The section's second coordinate is measured along ``normal``, (3,) or (L, 3), its first across it and the path.
    """
    along = np.roll(path, -1, 0) - np.roll(path, 1, 0) if closed else np.gradient(path, axis=0)
    normal = np.broadcast_to(normal, path.shape)
    side = np.cross(normal, along)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    normal = np.cross(along, side)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    section = np.broadcast_to(section, (len(path), *section.shape[-2:]))
    return loft(path[:, None] + section[..., :1] * side[:, None] + section[..., 1:] * normal[:, None], closed)


def spline(points: Sequence[Sequence[float] | np.ndarray], count: int, closed: bool = False) -> np.ndarray:
    """Smooth curve (count, D) through ``points``, evenly spaced in the points' own distances."""
    through = np.asarray(points, float)
    if closed:
        through = np.concatenate([through, through[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(through, axis=0), axis=1))])
    curve = CubicSpline(length, through, bc_type="periodic" if closed else "natural")
    return curve(np.linspace(0.0, length[-1], count, endpoint=not closed))


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
