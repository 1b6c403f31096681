"""How far the parts of an object cut into each other while its joints travel."""

import numpy as np
import trimesh

from omad.data.rendering.viewpoints import keep_possible
from omad.geometry.closest import nearest_of
from omad.geometry.mesh import Mesh, sample_triangles
from omad.geometry.rigid import box
from omad.objects.category import Category
from omad.objects.model import ObjectModel

STATES = 5
SAMPLES = 500


def solids(mesh: Mesh) -> list[Mesh]:
    """The closed surfaces that a part is a union of."""
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    labels = trimesh.graph.connected_component_labels(whole.face_adjacency, node_count=len(mesh.faces))
    return [Mesh(mesh.vertices, mesh.faces[labels == k]) for k in range(labels.max() + 1)]


def winding(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How often closed triangles (F, 3, 3) go round each point (N, 3): the sum of their solid angles over 4 pi."""
    a, b, c = (triangles[:, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    volume = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    spread = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return (2 * np.arctan2(volume, spread)).sum(1) / (4 * np.pi)


def travel_states(model: ObjectModel, category: Category, rng: np.random.Generator) -> np.ndarray:
    """(2 STATES, J): all joints equally far, and each anywhere that the others leave to it."""
    shares = np.repeat(np.linspace(0, 1, STATES)[:, None], len(model.limits), 1)
    shares = np.concatenate([shares, rng.choice(shares[:, 0], shares.shape)])
    states = model.limits[:, 0] + shares * np.ptp(model.limits, axis=1)
    keep_possible(states, model.limits, category.joints)
    return states


def deepest_cut(model: ObjectModel, category: Category, rng: np.random.Generator) -> float:
    """How deep a part's surface gets into one solid of another part, at most, as a share of the object's diagonal."""
    pieces = [solids(part) for part in model.parts]
    samples = [
        np.concatenate([part.vertices, sample_triangles(part.triangles, SAMPLES, rng)[0]]) for part in model.parts
    ]
    inside = [[_Depths(piece) for piece in each] for each in pieces]
    deepest = 0.0
    for states in travel_states(model, category, rng):
        T = model.part_transforms(states)
        for k, points in enumerate(samples):
            for other, depths in enumerate(inside):
                if other == k:
                    continue
                relative = np.linalg.inv(T[other]) @ T[k]
                moved = points @ relative[:3, :3].T + relative[:3, 3]
                deepest = max(deepest, *(each.deepest(moved, deepest) for each in depths))
    return deepest / model.diagonal


class _Depths:
    """Of points in one closed surface."""

    def __init__(self, piece: Mesh) -> None:
        self.triangles = np.ascontiguousarray(piece.triangles)
        self.low, self.high = box(self.triangles.reshape(-1, 3))

    def deepest(self, points: np.ndarray, least: float) -> float:
        """0 where none is deeper than ``least``."""
        margin = np.minimum(points - self.low, self.high - points).min(1)
        points = points[margin > least]
        if len(points) == 0:
            return 0.0
        points = points[winding(self.triangles, points) > 0.5]
        every = np.broadcast_to(np.arange(len(self.triangles)), (len(points), len(self.triangles)))
        nearest, _ = nearest_of(points, self.triangles, every)
        return float(np.linalg.norm(points - nearest, axis=1).max(initial=0.0))
