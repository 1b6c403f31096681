"""Object models: part meshes in canonical space at rest, and the joints that move them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch

from omad.common.arrays import digest_of, numbers
from omad.geometry.joint_kinds import Motion
from omad.geometry.kinematics import KinematicTree
from omad.geometry.mesh import Mesh, closed, merge_meshes, sample_triangles, triangle_normals
from omad.geometry.rigid import box, carry_each, rotate_each
from omad.geometry.transforms import MIRROR_X

from .category import Category
from .pose import ObjectPose, mirrored_axes

NEIGHBOURS = 10
"""Of a surface point, that tell its normal and how much of the surface it stands for."""
LEAST = 1 / 256
"""Share of an object's samples that each part has, however small it is: a part without any is none to learn."""


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points drawn uniformly by area from all parts of an object."""

    points: np.ndarray
    """(N, 3) float32 metres, canonical space at rest."""
    normals: np.ndarray
    """(N, 3) float32 unit, outward where the mesh is closed."""
    labels: np.ndarray
    """(N,) int64 part index."""


ODD_SIZE = 30.0
"""Times that an object's diagonal may be a category unit, or a part of it; one to three times is usual."""


def odd_size(diagonal: float, category: Category) -> str | None:
    """What to say of an object whose ``diagonal`` (metres) cannot be one of the category's: it is in another unit."""
    if 1 / ODD_SIZE < diagonal / category.metres_per_unit < ODD_SIZE:
        return None
    return f"is {diagonal:.3g} m across, where metres_per_unit of {category.name} is {category.metres_per_unit:g}"


def diagonal(part_boxes: np.ndarray) -> float:
    """Diagonal in metres of the box around part boxes (K, 2, 3)."""
    return float(np.linalg.norm(part_boxes[:, 1].max(0) - part_boxes[:, 0].min(0)))


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """An articulated object in its category's canonical space (y up, z front, rest box centred on the origin)."""

    name: str
    """Of the object."""
    category: str
    """The category's name."""
    part_names: tuple[str, ...]
    """The base first."""
    parts: tuple[Mesh, ...]
    """A mesh each, at rest: metres, canonical space."""
    joint_names: tuple[str, ...]
    """Joint j moves part j + 1."""
    tree: KinematicTree
    """What hangs on what."""
    axes: np.ndarray
    """(J, 3) float64 unit, canonical space."""
    pivots: np.ndarray
    """(J, 3) float64 metres, canonical space; any point (the origin) where the axis has no place."""
    limits: np.ndarray
    """(J, 2) float64 radians or metres, zero is the rest state."""
    at_most: tuple[int | None, ...] = ()
    """Per joint, another one than which it does not go further; none where empty."""
    of_other_hand: bool = False
    """The object that it was imported from is its mirror image (``Category.either_hand``)."""

    @classmethod
    def of(
        cls,
        category: Category,
        name: str,
        parts: Iterable[Mesh],
        axes: np.ndarray,
        pivots: np.ndarray,
        limits: np.ndarray | None = None,
        motions: Iterable[Motion] | None = None,
    ) -> Self:
        """An object whose parts and joints are those of its category, as are limits and motions (metres) where it has
        none of its own; fields as above."""
        tree = category.metric_tree if motions is None else replace(category.metric_tree, motions=tuple(motions))
        limits = category.metric_limits if limits is None else limits
        links, joints = (tuple(each.name for each in specs) for specs in (category.parts, category.joints))
        axes, pivots = np.array(axes), np.array(pivots)
        at_most = tuple(joint.at_most for joint in category.joints)
        return cls(name, category.name, links, tuple(parts), joints, tree, axes, pivots, limits, at_most)

    def possible(self, states: np.ndarray, joints: Sequence[int] | None = None) -> np.ndarray:
        """(S,) bool: in which of states (S, J) no joint goes further than the one that it must not (``at_most``), where
        both are of ``joints``; the others may be anywhere. Default: all."""
        possible, told = np.ones(len(states), dtype=bool), range(len(self.axes)) if joints is None else joints
        for joint, other in enumerate(self.at_most):
            if other is not None and joint in told and other in told:
                possible &= states[:, joint] <= states[:, other].clip(*self.limits[joint]) + 1e-9
        return possible

    def part_transforms(self, states: np.ndarray, T_camera_base: np.ndarray | None = None) -> np.ndarray:
        """(K, 4, 4) canonical -> camera (or base, if no pose is given) for joint states (J,)."""
        return self.placed(states, T_camera_base).T_camera_part

    def placed(self, states: np.ndarray, T_camera_base: np.ndarray | None = None) -> ObjectPose:
        """Parts and joints in the camera (or base, if no pose is given) for joint states (J,)."""
        states = numbers(states, len(self.axes), what="states", unknown=True)
        pose = np.eye(4) if T_camera_base is None else T_camera_base
        batch = [torch.as_tensor(np.asarray(a, dtype=np.float64))[None] for a in (self.axes, self.pivots, states, pose)]
        return ObjectPose.at(self.tree, *batch).rows()[0]

    def posed(self, states: np.ndarray, T_camera_base: np.ndarray | None = None) -> tuple[Mesh, ...]:
        """Every part where it is at joint states (J,)."""
        placed = zip(self.parts, self.part_transforms(states, T_camera_base), strict=True)
        return tuple(part.carried(T) for part, T in placed)

    def posed_vertices(self, states: np.ndarray, T_camera_base: np.ndarray | None = None) -> list[np.ndarray]:
        """Vertices of each part, (V, 3) each, at joint states (J,)."""
        return [part.vertices for part in self.posed(states, T_camera_base)]

    def face_parts(self) -> np.ndarray:
        """(F,) uint8 part of every face of all parts together."""
        return np.repeat(np.arange(len(self.parts), dtype=np.uint8), [len(part.faces) for part in self.parts])

    def part_boxes(self) -> np.ndarray:
        """(K, 2, 3) low and high corners of each part's box at rest."""
        return np.stack([box(part.vertices) for part in self.parts])

    @property
    def diagonal(self) -> float:
        """Diagonal of the whole object's rest box in metres."""
        return diagonal(self.part_boxes())

    @property
    def closed(self) -> bool:
        """Whether every part is a union of closed, outward-oriented surfaces."""
        return all(map(closed, self.parts))

    def with_zero_at(self, states: np.ndarray) -> Self:
        """The same object, its joints' zero moved to ``states`` (J,), radians or metres."""
        parents = self.part_transforms(states)[list(self.tree.parents)]
        return replace(
            self,
            parts=self.posed(states),
            axes=rotate_each(parents, self.axes),
            pivots=carry_each(parents, self.pivots),
            limits=self.limits - states[:, None],
        )

    def centred(self) -> Self:
        """The same object with its rest box centred on the origin."""
        centre = box(self.part_boxes().reshape(-1, 3)).sum(0) / 2
        parts = tuple(part.warped(lambda vertices: vertices - centre) for part in self.parts)
        pivots = np.where(np.array(self.tree.turning)[:, None], self.pivots - centre, 0.0)
        return replace(self, parts=parts, pivots=pivots)

    def mirrored(self) -> Self:
        """Its image in the plane x = 0. States keep their signs: what turned one way about an axis turns the other way
        about the axis' image, so that the image is turned round."""
        axes = mirrored_axes(self.axes, self.tree.turning)
        motions = tuple(
            replace(motion, slide=-motion.slide) if motion.turns else motion for motion in self.tree.motions
        )
        parts = tuple(part.mirrored() for part in self.parts)
        tree = replace(self.tree, motions=motions)
        return replace(self, parts=parts, axes=axes, pivots=self.pivots * MIRROR_X, tree=tree)

    def stretched(self, factors: np.ndarray) -> Self:
        """The same object with other proportions: its rest state scaled by ``factors`` (3,) along the canonical axes,
        and its slides' limits by how much longer their axes become."""
        axes = self.axes * factors
        longer = np.linalg.norm(axes, axis=1, keepdims=True)
        limits = np.where(np.array(self.tree.turning)[:, None], self.limits, self.limits * longer)
        parts = tuple(part.warped(lambda vertices: vertices * factors) for part in self.parts)
        return replace(self, parts=parts, axes=axes / longer, pivots=self.pivots * factors, limits=limits)

    def surface_samples(self, count: int, rng: np.random.Generator) -> SurfaceSamples:
        """``count`` points by area over all parts together, but for parts so small that they have ``LEAST`` of them."""
        triangles, part_of = np.concatenate([part.triangles for part in self.parts]), self.face_parts()
        points, chosen = sample_triangles(triangles, count, rng)
        lacking = int(LEAST * count) - np.bincount(part_of[chosen], minlength=len(self.parts))
        for part in np.flatnonzero(lacking > 0):
            own, replaced = np.flatnonzero(part_of == part), part_of[chosen] == lacking.argmin()
            rows = np.flatnonzero(replaced)[: lacking[part]]  # in the order drawn, which is random
            points[rows], which = sample_triangles(triangles[own], len(rows), rng)
            chosen[rows] = own[which]
        normals = triangle_normals(triangles[chosen])
        unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        labels = part_of[chosen].astype(np.int64)
        return SurfaceSamples(points.astype(np.float32), unit.astype(np.float32), labels)


def digest_of_models(models: Iterable[ObjectModel]) -> str:
    """Tells objects from others, which a generator or a folder of one's own may give the next time."""
    arrays = dict[str, np.ndarray]()
    for number, model in enumerate(models):
        mesh, joints = merge_meshes(model.parts), (model.axes, model.pivots, model.limits)
        told = zip(("vertices", "faces", "axes", "pivots", "limits"), (mesh.vertices, mesh.faces, *joints), strict=True)
        arrays |= {f"{number} {name}": array for name, array in told}
    return digest_of(arrays)


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
    """(N,) shares of the surface that the points stand for; together hardly less than ``LEAST`` a part."""
    closed = False

    @classmethod
    def from_clouds(
        cls, name: str, clouds: list[np.ndarray], axes: np.ndarray, pivots: np.ndarray, limits: np.ndarray
    ) -> Self:
        """From points (n, 3) of each part, ``NEIGHBOURS`` or more; parts may be sampled unequally densely."""
        normals, areas = zip(*(_local_planes(cloud) for cloud in clouds), strict=True)
        least = LEAST * sum(area.sum() for area in areas)
        areas = [area * max(least / area.sum(), 1.0) for area in areas]
        points, normal, area = (np.concatenate(each) for each in (clouds, normals, areas))
        labels = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
        surface = SurfaceSamples(points.astype(np.float32), normal.astype(np.float32), labels)
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
    from scipy.spatial import KDTree  # slow to import

    distances, nearest = KDTree(points).query(points, NEIGHBOURS)
    around = points[nearest] - points[nearest].mean(1, keepdims=True)
    normals = np.linalg.eigh(around.transpose(0, 2, 1) @ around)[1][..., 0]
    return normals, np.full(len(points), np.median(distances[:, -1]) ** 2)
