"""A known object whose surface follows its keypoints.

Each part's surface moves with the affine map that brings the part's keypoints nearest to where they are wanted, held
to the identity by a ridge. The map is linear in the keypoints, so every point of the surface is a fixed offset plus a
weighted sum of keypoints. Canonical space at rest, category units. M keypoints, m of one part.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from omad.geometry.mesh import Mesh, sample_triangles, triangle_normals
from omad.objects.model import ObjectModel

RIDGE = 0.01
"""Square of a length: along directions in which a part's keypoints spread less, the surface keeps the template's."""
SAMPLES = 1500
"""Points of the surface that are held against a cloud."""


@dataclass(frozen=True)
class Skin:
    """Points that follow one part's keypoints."""

    weights: np.ndarray
    """(V, m), each row sums to one."""
    offsets: np.ndarray
    """(V, 3) what of the points the keypoints do not carry."""

    @classmethod
    def of(cls, points: np.ndarray, keypoints: np.ndarray) -> Self:
        """Points (V, 3) where the part's keypoints are at ``keypoints`` (m, 3)."""
        centre = keypoints.mean(0)
        spread = keypoints - centre
        inverse = np.linalg.solve(spread.T @ spread / len(spread) + RIDGE * np.eye(3), spread.T)
        weights = ((points - centre) @ inverse + 1) / len(spread)
        return cls(weights, points - weights @ keypoints)

    def at(self, keypoints: np.ndarray) -> np.ndarray:
        """(..., V, 3) for the part's keypoints (..., m, 3)."""
        return self.offsets + self.weights @ keypoints


@dataclass(frozen=True)
class PartTemplate:
    """One part's surface."""

    keypoints: slice
    """Which of all keypoints carry it."""
    known: np.ndarray
    """(m, 3) where they are on the object that it comes from."""
    faces: np.ndarray
    """(F, 3)."""
    vertices: Skin
    samples: Skin
    """Points all over the surface, equally dense."""
    normals: np.ndarray
    """(S, 3) of the samples, outward."""


@dataclass(frozen=True)
class Template:
    """A known object, or parts of several."""

    parts: tuple[PartTemplate, ...]

    def with_parts(self, some: slice, other: Self) -> Self:
        """The same with ``some`` parts of another one."""
        parts = list(self.parts)
        parts[some] = other.parts[some]
        return type(self)(tuple(parts))

    @classmethod
    def of(cls, model: ObjectModel, unit: float, keypoints: np.ndarray, of_part: tuple[slice, ...]) -> Self:
        """An object (metres, ``unit`` of them a category unit) with its keypoints (M, 3), in category units."""
        triangles = np.concatenate([part.triangles for part in model.parts]) / unit
        points, chosen = sample_triangles(triangles, SAMPLES, np.random.default_rng(0))
        normals = triangle_normals(triangles[chosen])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        labels, parts = model.face_parts()[chosen], []
        for part, (mesh, own) in enumerate(zip(model.parts, of_part, strict=True)):
            inside, known = labels == part, keypoints[own]
            skins = Skin.of(mesh.vertices / unit, known), Skin.of(points[inside], known)
            parts.append(PartTemplate(own, known, mesh.faces, *skins, normals[inside]))
        return cls(tuple(parts))

    def at(self, keypoints: np.ndarray) -> tuple[Mesh, ...]:
        """Each part's mesh for keypoints (M, 3), in their unit of length if that is the template's."""
        return tuple(Mesh(part.vertices.at(keypoints[part.keypoints]), part.faces.copy()) for part in self.parts)
