"""Closed, outward-oriented solids for the procedural generators. Lengths in metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from omad.common.lazy import lazy_imports
from omad.geometry.mesh import Mesh

with lazy_imports():
    from scipy.interpolate import CubicSpline  # a quarter of a second, and most answers need none

X, Y, Z = np.eye(3)
HEXAHEDRON = np.array(
    [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]  # sides
    + [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]  # ends
)
"""Triangles (12, 3) of ``hexahedron``'s corners."""


@dataclass(frozen=True)
class JointedParts:
    """What a generator makes: the parts of an object at rest, base first, and where its joints are."""

    parts: tuple[Mesh, ...]
    pivots: np.ndarray
    """(J, 3)."""
    axes: np.ndarray | None = None
    """(J, 3) unit; those of the category's spec where None."""
    limits: np.ndarray | None = None
    """(J, 2) radians or metres; those of the spec, whose joints turn, where None."""


def points(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> np.ndarray:
    """(..., 3) of coordinates that broadcast."""
    return np.stack(np.broadcast_arrays(x, y, z), -1)


def loft(rings: np.ndarray, closed: bool = False) -> Mesh:
    """Solid through a stack of rings (L, n, 3); ``closed``: the last joins the first.

    Otherwise both ends are capped, and the end rings must be star-shaped about their means.
    """
    grid = np.arange(rings[..., 0].size).reshape(rings.shape[:2])
    a, b = (grid, np.roll(grid, -1, 0)) if closed else (grid[:-1], grid[1:])
    a_next, b_next = np.roll(a, -1, 1), np.roll(b, -1, 1)
    faces = np.stack([np.stack([a, a_next, b_next], -1), np.stack([a, b_next, b], -1)], 1).reshape(-1, 3)
    vertices = rings.reshape(-1, 3)
    if not closed:
        bottom, top = len(vertices), len(vertices) + 1
        caps = points(np.roll(grid[0], -1), grid[0], bottom), points(grid[-1], np.roll(grid[-1], -1), top)
        faces = np.concatenate([faces, *caps])
        vertices = np.concatenate([vertices, rings[0].mean(0)[None], rings[-1].mean(0)[None]])
    return _outward(vertices, faces)


def hexahedron(corners: np.ndarray) -> Mesh:
    """Solid with eight corners (8, 3): a ring of four, then the ring opposite."""
    return _outward(corners, HEXAHEDRON)


def column(x0: float, x1: float, back: float, z0: float, z1: float, low: float, high: float) -> Mesh:
    """Upright solid from the plane z = ``back`` to the line from (``x0``, ``z0``) to (``x1``, ``z1``)."""
    ring = np.array([[x0, 0, back], [x1, 0, back], [x1, 0, z1], [x0, 0, z0]])
    return hexahedron(np.concatenate([ring + [0, low, 0], ring + [0, high, 0]]))


def box(low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray) -> Mesh:
    """Axis-aligned box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return column(x0, x1, z0, z1, z1, y0, y1)


def sides(low: Sequence[float], high: Sequence[float], wall: float) -> list[Mesh]:
    """Two panels, left and right inside the box between two corners."""
    (x0, *rest0), (x1, *rest1) = low, high
    return [box(low, (x0 + wall, *rest1)), box((x1 - wall, *rest0), high)]


def frame(low: Sequence[float], high: Sequence[float], rim: float, foot: float) -> list[Mesh]:
    """Left, right, bottom and top of a window in the box between two corners; the bottom is ``foot`` tall."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    bottom = box((x0 + rim, y0, z0), (x1 - rim, y0 + foot, z1))
    return [*sides(low, high, rim), bottom, box((x0 + rim, y1 - rim, z0), (x1 - rim, y1, z1))]


def posts(x: float, y: float, span: float, half: float, root: float, tip: float) -> list[Mesh]:
    """Two square posts, ``half`` their width, that carry a handle's bar ``span`` to both sides of ``x``."""
    return [box((x + s * span - half, y - half, root), (x + s * span + half, y + half, tip)) for s in (-1, 1)]


def rounded_rectangle(width: float, height: float, radius: float, segments: int = 4) -> np.ndarray:
    """Outline (n, 2) counter-clockwise, centred on the origin."""
    radius = float(np.clip(radius, 1e-4, 0.49 * min(width, height)))
    quarters = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    angles = np.linspace(np.arange(4), np.arange(1, 5), segments + 1, axis=1) * np.pi / 2
    centres = quarters * (np.array([width, height]) / 2 - radius)
    return (centres[:, None] + radius * np.stack([np.cos(angles), np.sin(angles)], -1)).reshape(-1, 2)


def slab(
    low: Sequence[float] | np.ndarray,
    high: Sequence[float] | np.ndarray,
    axis: int,
    radius: float,
    bevel: float = 0.0,
) -> Mesh:
    """Box whose four edges along ``axis`` are rounded by ``radius`` and whose two faces across it are bevelled."""
    lo, hi = np.asarray(low, float), np.asarray(high, float)
    across = [a for a in range(3) if a != axis]
    (width, height), centre = (hi - lo)[across], ((lo + hi) / 2)[across]
    start, end = lo[axis], hi[axis]
    bevel = float(np.clip(bevel, 0.0, 0.45 * (end - start)))
    levels = [(start, bevel), (start + bevel, 0.0), (end - bevel, 0.0), (end, bevel)][:: 1 if bevel else 3]
    outlines = [rounded_rectangle(width - 2 * inset, height - 2 * inset, radius, 3) for _, inset in levels]
    rings = [np.insert(outline + centre, axis, z, 1) for outline, (z, _) in zip(outlines, levels, strict=True)]
    return loft(np.stack(rings))


def cylinder(
    start: Sequence[float] | np.ndarray, end: Sequence[float] | np.ndarray, radius: float, segments: int = 10
) -> Mesh:
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


def squared(wave: np.ndarray, power: np.ndarray | float) -> np.ndarray:
    """A cosine or sine to a power, with its sign: of an outline, 1 is an ellipse, less is nearer to a rectangle."""
    return np.sign(wave) * np.abs(wave) ** power


def sweep(path: np.ndarray, normal: np.ndarray, section: np.ndarray, closed: bool = False) -> Mesh:
    """Solid along a path (L, 3), open or a loop, with a cross-section (n, 2) or one a point of the path (L, n, 2).

    The section's second coordinate is measured along ``normal``, (3,) or (L, 3), its first across it and the path.
    """
    along = np.roll(path, -1, 0) - np.roll(path, 1, 0) if closed else np.gradient(path, axis=0)
    side = np.cross(np.broadcast_to(normal, path.shape), along)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    normal = np.cross(along, side)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    section = np.broadcast_to(section, (len(path), *section.shape[-2:]))
    return loft(path[:, None] + section[..., :1] * side[:, None] + section[..., 1:] * normal[:, None], closed)


def taper(section: np.ndarray, wide: ArrayLike, tall: ArrayLike) -> np.ndarray:
    """A cross-section (n, 2) stretched at each of L points of a path -> (L, n, 2)."""
    return section * np.stack(np.broadcast_arrays(wide, tall), -1)[:, None]


def spline(points: Sequence[Sequence[float] | np.ndarray], count: int) -> np.ndarray:
    """Smooth curve (count, D) through ``points``, evenly spaced in the points' own distances."""
    through = np.asarray(points, float)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(through, axis=0), axis=1))])
    return CubicSpline(length, through, bc_type="natural")(np.linspace(0.0, length[-1], count))


def _outward(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    with np.errstate(invalid="ignore"):  # of numbers that are none, which a check names
        volume = np.linalg.det(vertices[faces]).sum()
    return Mesh(vertices, faces if volume > 0 else faces[:, ::-1])
