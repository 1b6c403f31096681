"""An estimated object as simulators take it: surfaces to show, bodies to collide, masses, and joints that hold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from omad.estimation.estimate import Estimate
from omad.geometry.convex.bodies import united
from omad.geometry.mesh import Mesh, closed, merge_meshes
from omad.geometry.rigid import carry_each
from omad.objects.model import ObjectModel
from omad.sensing.observation import Observation

from ..frame import CAMERA, Frame
from ..ply import part_surfaces
from .collision import collision_bodies, relative_places

EMPTY = 0.02
"""Metres: sides of the box whose mass a link without a body has."""
LEAST = 1e-14
"""kg m^2: simulators refuse what is turned about some axis with less, as the hull of a part with few keypoints is."""
DENSITY = 300.0
"""kg per cubic metre of a part's volume; a guess, a depth image shows no mass."""
GRAVITY = 9.81
"""Metres per square second."""
HOLD = 1.5
"""How many times the weight of what hangs on it a joint's friction carries, however the object is turned."""
DAMPING = 0.1
"""Seconds: a joint's damping per friction."""


@dataclass(frozen=True)
class Solid:
    """How a link resists being moved; link frame."""

    mass: float
    """kg."""
    centre: np.ndarray
    """(3,) of mass, metres."""
    inertia: np.ndarray
    """(3, 3) about the centre, kg m^2."""

    @classmethod
    def of(cls, mesh: Mesh | None) -> Solid:
        """Of what closed solids enclose, once where they overlap; of a small box where there is none, or next to none:
        simulators need some mass."""
        import trimesh  # slow to import

        solid = trimesh.creation.box(extents=[EMPTY] * 3)
        if mesh is not None:
            surface = united(mesh)
            solid = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
        solid.density = DENSITY
        found = cls(float(solid.mass), np.asarray(solid.center_mass), np.asarray(solid.moment_inertia))
        return found if mesh is None or np.linalg.eigvalsh(found.inertia)[0] >= LEAST else cls.of(None)


@dataclass(frozen=True)
class Robot:
    """One estimate. A link's frame stands, turned as canonical space at rest, at its joint's pivot; that of the base
    and of joints that only slide at the canonical origin."""

    model: ObjectModel
    """Surfaces and joints, canonical space at rest."""
    states: np.ndarray
    """(J,) estimated."""
    root: Frame
    T_root_link: np.ndarray
    """(K, 4, 4) at the estimated states."""

    @classmethod
    def of(cls, estimate: Estimate, name: str, observation: Observation | None = None, frame: Frame = CAMERA) -> Robot:
        """What was estimated, in ``frame``."""
        model = replace(estimate.object_model(name), parts=tuple(part_surfaces(estimate, observation)))
        return cls(model, estimate.joint_states, frame, frame.T_frame_camera @ link_frames(estimate))

    @cached_property
    def bodies(self) -> tuple[tuple[Mesh, ...], ...]:
        """Convex ones of each part, canonical space at rest."""
        return tuple(tuple(body.mesh for body in of_part) for of_part in collision_bodies(self.model))

    @cached_property
    def places(self) -> np.ndarray:
        """(K, 3) of the links' frames in canonical space at rest."""
        return _places(self.model.pivots)

    @property
    def offsets(self) -> np.ndarray:
        """(J, 3) of the joints' links from the links that they hang on, at rest."""
        return self.places[1:] - self.places[list(self.model.tree.parents)]

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        """Of each link: what its surface encloses, or its bodies where that is not closed."""
        found = []
        for part, of_part, place in zip(self.model.parts, self.bodies, self.places, strict=True):
            mesh = part if closed(part) else merge_meshes(of_part) if of_part else None
            found.append(Solid.of(None if mesh is None else mesh.warped(lambda v, place=place: v - place)))
        return tuple(found)

    @cached_property
    def friction(self) -> np.ndarray:
        """(J,) N m, or N of a slide: nothing moves by its own weight, whatever state the joints beyond are in."""
        tree, moments = self.model.tree, []
        for joint, motion in enumerate(tree.motions):
            moment = 0.0
            for part, solid in enumerate(self.solids):
                if joint in tree.path(part):
                    arm = self._arm(joint, part) if motion.turns else 0.0
                    moment += solid.mass * (abs(motion.turn) * arm + abs(motion.slide))
            moments.append(HOLD * GRAVITY * moment)
        return np.array(moments)

    def _arm(self, joint: int, part: int) -> float:
        """Metres, how far a part's centre of mass comes from a joint's axis at most."""
        places = relative_places(self.model, self.model.tree.parents[joint], part)
        centres = carry_each(places, self.solids[part].centre + self.places[part])
        away = np.cross(self.model.axes[joint], centres - self.model.pivots[joint])
        return float(np.linalg.norm(away, axis=-1).max())

    @property
    def damping(self) -> np.ndarray:
        """(J,) N m s, or N s / m of a slide."""
        return DAMPING * self.friction

    @property
    def down(self) -> np.ndarray:
        """(3,) unit, where things fall in the root's frame: the object stands upright where nothing else is known."""
        return np.array([0.0, 0.0, -1.0]) if self.root.upright else -self.T_root_link[0, :3, 1]


def link_frames(estimate: Estimate) -> np.ndarray:
    """(K, 4, 4) camera frame: where links are at the estimated state."""
    frames = estimate.T_camera_part.copy()
    frames[:, :3, 3] = carry_each(frames, _places(estimate.canonical_pivots))
    return frames


def _places(pivots: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros((1, 3)), pivots])
