"""Triangle meshes: one part's surface, several as one, the hull of points."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from .rigid import carry
from .transforms import MIRROR_X


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one part."""

    vertices: np.ndarray
    """(V, 3) float64 metres."""
    faces: np.ndarray
    """(F, 3) int64, counter-clockwise seen from outside where the mesh is closed."""

    def __repr__(self) -> str:
        return f"<Mesh: {len(self.vertices)} vertices, {len(self.faces)} faces>"

    @property
    def triangles(self) -> np.ndarray:
        """(F, 3, 3) corners of every face."""
        return self.vertices[self.faces]

    def warped(self, move: Callable[[np.ndarray], np.ndarray]) -> Self:
        """The mesh with its vertices (V, 3) mapped by ``move``."""
        return type(self)(move(self.vertices), self.faces)

    def carried(self, T: np.ndarray) -> Self:
        """The mesh moved by T (4, 4)."""
        return self.warped(lambda vertices: carry(T, vertices))

    def mirrored(self) -> Self:
        """Its image in the plane x = 0; faces are turned round, so that closed meshes stay outward."""
        return type(self)(self.vertices * MIRROR_X, self.faces[:, ::-1])


def merge_meshes(meshes: Iterable[Mesh]) -> Mesh:
    """One mesh of several, in their order; each stays closed by itself."""
    meshes = [Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), *meshes]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def closed(mesh: Mesh) -> bool:
    """Whether a mesh is a union of closed, outward-oriented surfaces: each face's edges are met as often from their
    other side, however many solids share one, and what they enclose is positive."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    there, back = (np.sort(a * len(mesh.vertices) + b) for a, b in (edges.T, edges.T[::-1]))
    a, b, c = (mesh.triangles - mesh.vertices.mean(0)).swapaxes(0, 1) if len(edges) else np.zeros((3, 1, 3))
    return np.array_equal(there, back) and float((a * np.cross(b, c)).sum()) > 0


def triangle_normals(triangles: np.ndarray) -> np.ndarray:
    """(F, 3) normals of triangles (F, 3, 3), each twice as long as its triangle's area."""
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def sample_triangles(triangles: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """``count`` points (N, 3) drawn uniformly by area from triangles (F, 3, 3), and the triangle of each, (N,)."""
    area = np.linalg.norm(triangle_normals(triangles), axis=1)
    chosen = rng.choice(len(triangles), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    a, b, c = triangles[chosen].swapaxes(0, 1)
    return a + u * (b - a) + v * (c - a), chosen


def convex_hull(points: np.ndarray) -> Mesh:
    """Convex hull, oriented outward; a flat set of points is given a little thickness first."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    options = "Qt Q12"  # where points are cut from planes, facets merge by more than rounding, and are right
    try:
        hull = ConvexHull(points, qhull_options=options)
    except QhullError:
        size = 1e-3 * max(float(np.ptp(points, axis=0).max()), 1e-3)
        points = np.concatenate([points + size * corner for corner in np.vstack([np.eye(3), -np.eye(3)])])
        hull = ConvexHull(points, qhull_options=options)
    used, faces = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = points[used].astype(np.float64), faces.reshape(-1, 3)
    inward = (triangle_normals(vertices[faces]) * hull.equations[:, :3]).sum(1) < 0
    return Mesh(vertices, np.where(inward[:, None], faces[:, ::-1], faces))
