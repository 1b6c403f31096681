"""What is seen of an object beyond what its template can be: a smooth displacement of each part.

    d(x) = K(x, X) (K(X, X) + diag(v))^-1 D        K(x, x') = size^2 exp(-|x - x'|^2 / (2 length^2))

the mean of a Gaussian process (Rasmussen and Williams, Gaussian Processes for Machine Learning, eq. 2.25). X: visible
points of the placed template, D: how far their partners in the cloud are from them, v: variances. Pairs are found anew
in each step, from where the surface is then. What is hidden goes along with what is seen near it, all else stays.
Camera frame, category units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from omad.geometry.mesh import Mesh

from .fitting import SurfaceFit
from .placed import Floats, Placed, VisibleSurface
from .template import Template

STEPS = 3
SIZE = 0.05
"""Standard deviation of a displacement, category units."""
LENGTH = 0.1
"""Over which displacements are alike, category units."""
ROBUST = 0.12
"""Pairs farther apart, category units, hardly count."""


@dataclass(frozen=True)
class Displacement:
    """Of one part."""

    at: Floats
    """(P, 3)"""
    weights: Floats
    """(P, 3)"""

    @classmethod
    def of(cls, at: Floats, off: Floats, variances: Floats) -> Displacement:
        """That moves points ``at`` (P, 3) by ``off`` (P, 3), as far as ``variances`` (P,) hold it to that."""
        weights = np.linalg.solve(_kernel(at, at) + np.diag(variances), off)
        return cls(at, weights.astype(np.float64))

    def __call__(self, points: Floats) -> Floats:
        """Where points (N, 3) are then."""
        return points + _kernel(points, self.at) @ self.weights


def followed(fit: SurfaceFit, placed: Placed, template: Template) -> list[Mesh]:
    """Each part of a ``placed`` template, canonical space at rest, displaced to where the cloud is."""
    seen = fit.visible(placed, template)
    moved, displaced = seen, dict[int, Displacement]()
    for _ in range(STEPS):
        displaced = _displacements(fit, seen, moved)
        now = seen.points.copy()
        for part, move in displaced.items():
            own = seen.parts == part
            now[own] = move(seen.points[own])
        moved = replace(seen, points=now)
    meshes = list(template.at(placed.keypoints))
    for part, move in displaced.items():
        T = placed.pose.T_camera_part[part]
        meshes[part] = meshes[part].carried(T).warped(move).carried(np.linalg.inv(T))
    return meshes


def _displacements(fit: SurfaceFit, seen: VisibleSurface, moved: VisibleSurface) -> dict[int, Displacement]:
    """From the surface that is ``seen`` to the cloud, by part, with pairs of where it was ``moved`` to, within
    a part; none of parts without any."""
    pairs = fit.pairs(moved)
    if not pairs:
        return {}
    cloud, surface = (np.concatenate(each) for each in zip(*((p.points, p.surface) for p in pairs), strict=True))
    far = [fit.cloud.points[each.points] - moved.points[each.surface] for each in pairs]
    known = [each.precision(off, fit.config.noise, ROBUST) for each, off in zip(pairs, far, strict=True)]
    at, to, variances = seen.points[surface], fit.cloud.points[cloud], 1 / np.concatenate(known)
    parts, same = seen.parts[surface], fit.cloud.labels[cloud] == seen.parts[surface]
    rows = {int(part): same & (parts == part) for part in np.unique(parts[same])}
    return {part: Displacement.of(at[own], to[own] - at[own], variances[own]) for part, own in rows.items()}


def _kernel(a: Floats, b: Floats) -> Floats:
    """(N, P) of points (N, 3) and (P, 3)."""
    from scipy.spatial.distance import cdist  # slow to import

    return SIZE**2 * np.exp(cdist(a, b, "sqeuclidean") / (-2 * LENGTH**2))
