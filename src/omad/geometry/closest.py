"""How far points are from a surface of triangles."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from omad.common.compiled import jit

from .mesh import sample_triangles

CANDIDATES = 6
"""Samples around a point, on whose triangles the nearest point is looked for."""


@dataclass(frozen=True)
class Surface:
    """Triangles with samples on them, by which the nearest ones are found."""

    triangles: np.ndarray
    """(F, 3, 3) float64."""
    which: np.ndarray
    """(S,) triangle of every sample."""
    tree: Any
    """KD tree of the samples."""

    @classmethod
    def of(cls, triangles: np.ndarray, samples: int, rng: np.random.Generator) -> Self:
        """Triangles (F, 3, 3) and as many ``samples`` by area; their middles are added, so that none goes without."""
        from scipy.spatial import KDTree  # slow to import

        points, which = sample_triangles(triangles, samples, rng)
        points = np.concatenate([points, triangles.mean(1)])
        which = np.concatenate([which, np.arange(len(triangles))])
        return cls(np.ascontiguousarray(triangles, dtype=np.float64), which, KDTree(points))

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The point of the surface that is nearest to each of points (N, 3) -> (N, 3), and its triangle (N,)."""
        _, near = self.tree.query(points, CANDIDATES)
        return nearest_of(np.ascontiguousarray(points, dtype=np.float64), self.triangles, self.which[near])

    def distances(self, points: np.ndarray) -> np.ndarray:
        """(N,) of points (N, 3)."""
        return np.linalg.norm(points - self.nearest(points)[0], axis=1)


@jit
def nearest_of(points, triangles, candidates):
    """Nearest points (N, 3) on the nearest of each point's own candidate triangles (N, C), and which it is (N,)."""
    found, which = np.empty_like(points), np.empty(len(points), np.int64)
    for n in range(len(points)):
        least = np.inf
        for f in candidates[n]:
            x, y, z = _on_triangle(points[n], triangles[f, 0], triangles[f, 1], triangles[f, 2])
            apart = (points[n, 0] - x) ** 2 + (points[n, 1] - y) ** 2 + (points[n, 2] - z) ** 2
            if apart < least:
                least, which[n] = apart, f
                found[n, 0], found[n, 1], found[n, 2] = x, y, z
    return found, which


@jit
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def _between(a, b, c, v, w):
    """a + v (b - a) + w (c - a)."""
    x = a[0] + v * (b[0] - a[0]) + w * (c[0] - a[0])
    y = a[1] + v * (b[1] - a[1]) + w * (c[1] - a[1])
    return x, y, a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2])


@jit
def _on_triangle(p, a, b, c):
    """Nearest point to ``p`` on the triangle a b c, by the region of its plane that p stands over (Ericson, Real-Time
    Collision Detection, 5.1.5)."""
    ab, ac, ap, bp, cp = b - a, c - a, p - a, p - b, p - c
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0 and d2 <= 0:
        return _between(a, b, c, 0.0, 0.0)
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0 and d4 <= d3:
        return _between(a, b, c, 1.0, 0.0)
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0 and d5 <= d6:
        return _between(a, b, c, 0.0, 1.0)
    of_c = d1 * d4 - d3 * d2
    if of_c <= 0 and d1 >= 0 and d3 <= 0 and d1 > d3:  # a is not b
        return _between(a, b, c, d1 / (d1 - d3), 0.0)
    of_b = d5 * d2 - d1 * d6
    if of_b <= 0 and d2 >= 0 and d6 <= 0:
        return _between(a, b, c, 0.0, d2 / (d2 - d6))
    of_a = d3 * d6 - d5 * d4
    if of_a <= 0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return _between(a, b, c, 1 - w, w)
    total = of_a + of_b + of_c
    if total <= 0:  # no area: a point or a line whose ends are handled above
        return _between(a, b, c, 0.0, 0.0)
    return _between(a, b, c, of_b / total, of_c / total)
