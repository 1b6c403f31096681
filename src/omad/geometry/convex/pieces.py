"""Solids as convex pieces: cut along their own faces, until each piece fills its hull.

A face that other faces of its solid lie before is where it is hollow or bent. A cut along one takes off what is behind
it: an open box comes apart into its five walls, exactly. A solid with more such faces than that is worth, as a bowl, is
halved across its longest side first. What is cut is a solid of Manifold (Apache 2.0), which cuts exactly and closes
what it cut.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self

import manifold3d
import numpy as np

from ..mesh import triangle_normals
from ..rigid import box, diagonal

FULL = 1.2
"""A piece whose hull is no more than so many times as large is convex enough."""
LITTLE = 2e-3
"""Of the solid's volume: what a piece may lack of its hull in any case."""
NOTHING = 1e-7
"""Of the solid's volume: smaller pieces are what is left of rounding."""
DEPTH = 0.01
"""Of the solid's size: other faces lie before one where they do by more than this."""
BESIDE = 2e-5
"""Of the solid's size, from a face to its cut: the face's own points are then surely behind it."""
FACES, TRIED = 20, 6
"""The most faces that others lie before, for a solid to be cut along them, and how many of the largest are tried."""
PIECES = 64
"""Of one solid at most."""
AT_ONCE = 4_000_000
"""Heights of vertices over faces that are looked at together."""


def convex_pieces(triangles: np.ndarray) -> list[np.ndarray]:
    """Vertices (V, 3) of the pieces that a closed solid of triangles (F, 3, 3) is made of; of one that is not closed,
    of all of it."""
    points, solid = _solid(triangles)
    if solid is None:
        return [points]
    size = diagonal(points)
    whole = solid.volume()
    pieces, done = [_Piece.of(each) for each in solid.decompose()], list[_Piece]()
    while pieces and len(pieces) + len(done) < PIECES:
        piece = pieces.pop(int(np.argmax([each.lacking for each in pieces])))
        enough = piece.lacking <= max((FULL - 1) * piece.volume, LITTLE * whole)
        cuts = [] if enough else [piece.cut(*plane, NOTHING * whole) for plane in piece.planes(size)]
        if cuts := [cut for cut in cuts if len(cut) > 1]:
            pieces += min(cuts, key=lambda cut: sum(each.lacking for each in cut))
        else:
            done.append(piece)
    return [_triangles(each.solid)[0] for each in (*done, *pieces)]


def union(solids: Iterable[np.ndarray]) -> np.ndarray | None:
    """Outer surface, triangles (F, 3, 3), of closed solids (F', 3, 3) each, which may overlap; None where any is not
    closed."""
    found = [solid for _, solid in map(_solid, solids)]
    whole = [solid for solid in found if solid is not None]
    if len(whole) < len(found):
        return None
    return _triangles(manifold3d.Manifold.batch_boolean(whole, manifold3d.OpType.Add))[1]


def _solid(triangles: np.ndarray) -> tuple[np.ndarray, manifold3d.Manifold | None]:
    """Vertices (V, 3) of triangles (F, 3, 3), and what these enclose, where they are closed and face outward."""
    points, corners = np.unique(triangles.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    faces = corners.reshape(-1, 3).astype(np.uint64)
    solid = manifold3d.Manifold(manifold3d.Mesh64(vert_properties=points, tri_verts=faces))
    return points, solid if solid.status() == manifold3d.Error.NoError and solid.volume() > 0 else None


def _triangles(solid: manifold3d.Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and triangles (F, 3, 3)."""
    mesh = solid.to_mesh64()
    vertices = mesh.vert_properties[:, :3].copy()
    return vertices, vertices[mesh.tri_verts.astype(np.int64)]


@dataclass(frozen=True)
class _Piece:
    """A connected solid."""

    solid: manifold3d.Manifold
    volume: float
    lacking: float
    """Volume of its hull that it does not fill."""

    @classmethod
    def of(cls, solid: manifold3d.Manifold) -> Self:
        return cls(solid, solid.volume(), solid.hull().volume() - solid.volume())

    def cut(self, normal: np.ndarray, at: float, nothing: float) -> list[Self]:
        """What it comes apart into at the plane ``normal . x = at``, of at least the volume ``nothing``."""
        halves = self.solid.split_by_plane(tuple(normal), at)
        return [self.of(part) for half in halves for part in half.decompose() if part.volume() > nothing]

    def planes(self, size: float) -> Iterator[tuple[np.ndarray, float]]:
        """Where it may be cut, normal (3,) and how far along that: along its largest faces that others lie before;
        across the middle of its longest side where there are too many."""
        vertices, triangles = _triangles(self.solid)
        normals = triangle_normals(triangles)
        areas = np.linalg.norm(normals, axis=1)
        normals /= np.maximum(areas, 1e-300)[:, None]
        at = (normals * triangles[:, 0]).sum(1)
        before = _hidden(vertices, normals, at + DEPTH * size)
        before = before[areas[before] > 0]
        alike = np.c_[normals, at / (DEPTH * size)][before].round(1)
        same = np.unique(alike, axis=0, return_inverse=True)[1].reshape(-1)
        if same.max(initial=-1) >= FACES:
            low, high = box(vertices)
            along = np.eye(3)[(high - low).argmax()]
            yield along, float(along @ (low + high)) / 2
            return
        for face in np.bincount(same, areas[before]).argsort(kind="stable")[::-1][:TRIED]:
            largest = before[same == face][areas[before[same == face]].argmax()]
            yield normals[largest], float(at[largest]) + BESIDE * size


def _hidden(vertices: np.ndarray, normals: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Of F planes with ``normals`` (F, 3), which any of ``vertices`` (V, 3) lie beyond ``at`` (F,) of: their indices. A
    block of planes at a time, as V times F numbers may be more than memory holds."""
    step = max(AT_ONCE // len(vertices), 1)
    starts = range(0, len(at), step)
    hidden = [(vertices @ normals[i : i + step].T).max(0) > at[i : i + step] for i in starts]
    return np.flatnonzero(np.concatenate(hidden))
