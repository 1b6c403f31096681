"""Convex bodies: solids as several of them, whether two overlap, and what is left of one that makes room."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..mesh import Mesh, convex_hull, triangle_normals
from ..rigid import box
from .pieces import convex_pieces, union

ROUNDED = 1e-9
"""Metres: what was cut at a gap, and carried there and back, is nearer by so much at most."""


@dataclass(frozen=True)
class ConvexBody:
    """The convex hull of its vertices."""

    mesh: Mesh
    """Oriented outward."""

    @classmethod
    def around(cls, points: np.ndarray) -> ConvexBody:
        """The hull of points (N, 3)."""
        return cls(convex_hull(points))

    @property
    def vertices(self) -> np.ndarray:
        """(V, 3)."""
        return self.mesh.vertices

    @cached_property
    def normals(self) -> np.ndarray:
        """(F, 3) unit, outward, of the faces that differ."""
        normals = triangle_normals(self.mesh.triangles)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.unique((normals / np.maximum(lengths, 1e-300)).round(6), axis=0)

    @cached_property
    def box(self) -> np.ndarray:
        """(2, 3) low and high corner."""
        return box(self.vertices)

    @cached_property
    def volume(self) -> float:
        """Cubic metres."""
        a, b, c = self.mesh.triangles.swapaxes(0, 1)
        return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6

    def carried(self, T: np.ndarray) -> ConvexBody:
        """Moved by T (4, 4)."""
        moved = ConvexBody(self.mesh.carried(T))
        vars(moved)["normals"] = self.normals @ T[:3, :3].T
        return moved

    def holds(self, points: np.ndarray, slack: float) -> bool:
        """Whether no point (N, 3) sticks out by more than ``slack``."""
        reach = (self.vertices @ self.normals.T).max(0)
        return bool((points @ self.normals.T <= reach + slack).all())

    def cut(self, normal: np.ndarray, least: float) -> ConvexBody | None:
        """What of it lies where ``normal . x`` is ``least`` or more; None where that is nothing."""
        height = self.vertices @ normal - least
        above, below = height > 0, height <= 0
        if not below.any():
            return self
        if height.max() < 1e-9:
            return None
        share = height[above, None] / (height[above, None] - height[None, below])
        ends = self.vertices[above, None], self.vertices[None, below]
        on_plane = (ends[0] + share[..., None] * (ends[1] - ends[0])).reshape(-1, 3)
        return ConvexBody.around(np.concatenate([self.vertices[above], on_plane]))


@dataclass(frozen=True)
class Overlap:
    """Across which face of either of two bodies they come apart when the least of one of them is cut off."""

    normal: np.ndarray
    """(3,) unit, from the first to the second."""
    first_end: float
    """How far the first one reaches along the normal."""
    second_start: float
    """Where the second one begins."""
    cut_second: bool
    """Which of them loses the smaller share of its extent along the normal."""


def overlap(first: ConvexBody, second: ConvexBody, gap: float) -> Overlap | None:
    """None where a face of either has the other one ``gap`` or more outside. Bodies that only an edge separates from an
    edge count as overlapping."""
    normals = np.concatenate([first.normals, -second.normals])
    one, other = first.vertices @ normals.T, second.vertices @ normals.T
    depth = one.max(0) - other.min(0) + gap
    if depth.min() <= ROUNDED:
        return None
    shares = depth / np.maximum(np.stack([np.ptp(one, axis=0), np.ptp(other, axis=0)]), 1e-12)
    cut_second, least = divmod(int(shares[::-1].argmin()), len(normals))
    return Overlap(normals[least], float(one[:, least].max()), float(other[:, least].min()), cut_second == 0)


def convex_bodies(mesh: Mesh, flush: float) -> list[ConvexBody]:
    """A mesh as convex bodies, largest first: a hull a connected solid, or several where the solid is hollow or bent.
    What sticks out of another body by no more than ``flush`` is left out."""
    pieces = (ConvexBody.around(piece) for solid in _solids(mesh) for piece in convex_pieces(solid))
    bodies = sorted(pieces, key=lambda body: -body.volume)
    kept: list[ConvexBody] = []
    for body in bodies:
        if not any(other.holds(body.vertices, flush) for other in kept):
            kept.append(body)
    return kept


def united(mesh: Mesh) -> Mesh:
    """The outer surface of connected solids that overlap, whose volume counts once; the mesh itself where these are not
    closed."""
    triangles = union(_solids(mesh))
    return mesh if triangles is None else Mesh(triangles.reshape(-1, 3), np.arange(triangles.size // 3).reshape(-1, 3))


def _solids(mesh: Mesh) -> list[np.ndarray]:
    """Triangles (F, 3, 3) of each connected piece."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    _, same = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    faces = same.reshape(-1)[mesh.faces]
    links = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(links)), links.T), shape=(len(mesh.vertices),) * 2)
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    return [mesh.triangles[piece == each] for each in np.unique(piece)]
