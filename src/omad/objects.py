"""Object models: part meshes in canonical space at rest, and the joints that move them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
import trimesh
from scipy.spatial import KDTree

from .kinematics import KinematicTree, part_transforms


@dataclass(frozen=True)
class Mesh:
    """Triangles of one part."""

    vertices: np.ndarray
    """(V, 3) float64 metres."""
    faces: np.ndarray
    """(F, 3) int64, counter-clockwise seen from outside where the mesh is closed."""


@dataclass(frozen=True)
class SurfaceSamples:
    """Points drawn uniformly by area from all parts of an object."""

    points: np.ndarray
    """(N, 3) float32 metres, canonical space at rest."""
    normals: np.ndarray
    """(N, 3) float32 unit, outward where the mesh is closed."""
    labels: np.ndarray
    """(N,) int64 part index."""


@dataclass(frozen=True)
class ObjectModel:
    """An articulated object in its category's canonical space (y up, z front, rest box centred on the origin)."""

    name: str
    category: str
    part_names: tuple[str, ...]
    parts: tuple[Mesh, ...]
    joint_names: tuple[str, ...]
    tree: KinematicTree
    axes: np.ndarray
    """(J, 3) float64 unit, canonical space."""
    pivots: np.ndarray
    """(J, 3) float64 metres, canonical space; for a prismatic joint any point (the origin)."""
    limits: np.ndarray
    """(J, 2) float64 radians or metres, zero is the rest state."""

    def part_transforms(self, states: np.ndarray, T_camera_base: np.ndarray | None = None) -> np.ndarray:
        """(K, 4, 4) canonical -> camera (or base, if no pose is given) for joint states (J,)."""
        pose = np.eye(4) if T_camera_base is None else T_camera_base
        batch = [torch.as_tensor(np.asarray(a, dtype=np.float64))[None] for a in (self.axes, self.pivots, states, pose)]
        return part_transforms(self.tree, *batch)[0].numpy()

    def posed_vertices(self, states: np.ndarray, T_camera_base: np.ndarray | None = None) -> list[np.ndarray]:
        """Vertices of each part, (V, 3) each, at ``states``."""
        transforms = self.part_transforms(states, T_camera_base)
        return [p.vertices @ T[:3, :3].T + T[:3, 3] for p, T in zip(self.parts, transforms, strict=True)]

    def part_boxes(self) -> np.ndarray:
        """(K, 2, 3) low and high corners of each part's box at rest."""
        return np.stack([[p.vertices.min(0), p.vertices.max(0)] for p in self.parts])

    @property
    def diagonal(self) -> float:
        """Diagonal of the whole object's rest box in metres."""
        boxes = self.part_boxes()
        return float(np.linalg.norm(boxes[:, 1].max(0) - boxes[:, 0].min(0)))

    @property
    def closed(self) -> bool:
        """Whether every part is a union of closed, outward-oriented surfaces."""
        meshes = [trimesh.Trimesh(p.vertices, p.faces, process=False) for p in self.parts]
        return all(mesh.is_watertight and mesh.volume > 0 for mesh in meshes)

    def centred(self) -> ObjectModel:
        """The same object with its rest box centred on the origin."""
        boxes = self.part_boxes()
        centre = (boxes[:, 0].min(0) + boxes[:, 1].max(0)) / 2
        revolute = np.array([kind == "revolute" for kind in self.tree.types])
        return replace(
            self,
            parts=tuple(Mesh(p.vertices - centre, p.faces) for p in self.parts),
            pivots=np.where(revolute[:, None], self.pivots - centre, 0.0),
        )

    def surface_samples(self, count: int, rng: np.random.Generator) -> SurfaceSamples:
        """``count`` points by area over all parts together."""
        triangles = np.concatenate([p.vertices[p.faces] for p in self.parts])
        labels = np.concatenate([np.full(len(p.faces), k) for k, p in enumerate(self.parts)])
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        area = np.linalg.norm(normals, axis=1)
        chosen = rng.choice(len(triangles), count, p=area / area.sum())
        u, v = rng.random((2, count, 1))
        flip = u + v > 1
        u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
        corner = triangles[chosen]
        points = corner[:, 0] + u * (corner[:, 1] - corner[:, 0]) + v * (corner[:, 2] - corner[:, 0])
        unit = normals[chosen] / area[chosen, None]
        return SurfaceSamples(points.astype(np.float32), unit.astype(np.float32), labels[chosen])


NEIGHBOURS = 10
"""Of a surface point, that tell its normal and how much of the surface it stands for."""


@dataclass(frozen=True)
class PointObject:
    """An articulated object of which only surface points are known: enough to train on, not to render."""

    name: str
    axes: np.ndarray
    """(J, 3) unit, canonical space."""
    pivots: np.ndarray
    """(J, 3) metres."""
    limits: np.ndarray
    """(J, 2) radians or metres."""
    surface: SurfaceSamples
    """(N,) points in all; normals may point to either side."""
    areas: np.ndarray
    """(N,) shares of the surface that the points stand for."""
    closed = False

    @classmethod
    def from_clouds(
        cls, name: str, clouds: list[np.ndarray], axes: np.ndarray, pivots: np.ndarray, limits: np.ndarray
    ) -> PointObject:
        """From points (n, 3) of each part, ``NEIGHBOURS`` or more; parts may be sampled unequally densely."""
        normals, areas = zip(*(_local_planes(cloud) for cloud in clouds), strict=True)
        surface = SurfaceSamples(
            points=np.concatenate(clouds).astype(np.float32),
            normals=np.concatenate(normals).astype(np.float32),
            labels=np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds]),
        )
        area = np.concatenate(areas)
        return cls(name, axes, pivots, limits, surface, area / area.sum())

    def surface_samples(self, count: int, rng: np.random.Generator) -> SurfaceSamples:
        """``count`` of the points, by area over all parts together; none repeats before it must."""
        order = rng.permutation(len(self.areas))
        steps = (np.arange(count) + rng.random()) / count  # evenly through the points laid end to end by area
        chosen = order[np.searchsorted(np.cumsum(self.areas[order]), steps).clip(max=len(order) - 1)]
        return SurfaceSamples(self.surface.points[chosen], self.surface.normals[chosen], self.surface.labels[chosen])


SampledObject = ObjectModel | PointObject
"""What surfaces can be drawn from."""


def _local_planes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (n, 3) of either sign, and the area (n,) that each point stands for, up to a common factor."""
    distances, nearest = KDTree(points).query(points, NEIGHBOURS)
    around = points[nearest] - points[nearest].mean(1, keepdims=True)
    normals = np.linalg.eigh(around.transpose(0, 2, 1) @ around)[1][..., 0]
    return normals, np.full(len(points), np.median(distances[:, -1]) ** 2)
