"""What is known of one observed object: the answer of the estimator, in metres, radians and the camera frame."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from omad.common.arrays import as_numpy
from omad.common.errors import InputError
from omad.common.files import write_json
from omad.geometry.joint_kinds import Motion
from omad.geometry.mesh import Mesh, convex_hull
from omad.geometry.rigid import rigid, turned_about
from omad.model.posed_object import PosedObject
from omad.model.surfaces.surfaces import PosedSurface, Surfaces
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.objects.pose import ObjectPose
from omad.objects.urdf import write_urdf

from .confidence.model import deviations
from .confidence.signals import Signals
from .part_labels import LabelledPoints

DOUBTFUL = 0.5
"""Probability of being right below which an answer is called doubtful."""
INTERVALS = (50, 90)
"""Per cent, of those that are written."""


@dataclass(frozen=True)
class JointEstimate:
    """One joint as seen now."""

    name: str
    type: str
    state: float
    """Radians or metres; 0 at rest."""
    state_std: float
    """Its standard deviation: half the interval that holds the true state 68 % of the time."""
    limits: tuple[float, float]
    axis: np.ndarray
    """(3,) unit, camera frame."""
    pivot: np.ndarray | None
    """(3,) a point of the axis, camera frame; None where the axis has no place: the joint only slides."""
    unit_motion: Motion
    """What a unit of state does: radians about the axis, metres along it."""
    tail: float = 1.0
    """The error is like ``state_std`` times this power of a normally distributed number: 1 of a normal distribution,
    more where a few answers are far off, as those seen the wrong way round."""

    def interval(self, level: float) -> tuple[float, float]:
        """What holds the true state with probability ``level``, as 0.9: around the estimated one, in its unit. Raises
        InputError for a level that is not between 0 and 1."""
        if not 0 < level < 1:
            raise InputError(f"level: {level} is no probability between 0 and 1; give 0.9, say")
        half = self.state_std * deviations(level) ** self.tail
        return self.state - half, self.state + half

    @property
    def fraction(self) -> float:
        """How much of its travel the joint has made, 0 to 1 (and beyond, where it is): from the limit that is nearer
        to the rest state, so that a joint that rests closed says how far it is open."""
        low, high = self.limits
        near, far = (high, low) if abs(high) < abs(low) else (low, high)
        return (self.state - near) / (far - near)

    @property
    def twist(self) -> np.ndarray:
        """(6,) screw axis in the camera frame, (angular, linear) per unit of state: a point p of the moving part goes
        with ``linear + angular x p``."""
        angular, linear = self.unit_motion.turn * self.axis, self.unit_motion.slide * self.axis
        return np.concatenate([angular, linear if self.pivot is None else linear + np.cross(self.pivot, angular)])

    def motion(self, travel: float) -> np.ndarray:
        """(4, 4) camera to camera: where a point of the moving part is after ``travel`` (radians or metres) more."""
        along = rigid(np.eye(3), travel * self.unit_motion.slide * self.axis)
        if self.pivot is None:
            return along
        from scipy.spatial.transform import Rotation  # slow to import

        turn = Rotation.from_rotvec(travel * self.unit_motion.turn * self.axis)
        return along @ turned_about(turn.as_matrix(), self.pivot)


def _joints(
    specs: Sequence[tuple[str, str, tuple[float, float], Motion]],
    placed: ObjectPose,
    state_std: Sequence[float],
    tail: Sequence[float],
) -> tuple[JointEstimate, ...]:
    """Of one object; ``specs`` are names, types, limits and what a unit of state does."""
    rows = zip(specs, placed.states.tolist(), state_std, placed.axes, placed.pivots, tail, strict=True)
    return tuple(
        JointEstimate(name, kind, state, std, limits, axis, pivot if motion.turns else None, motion, power)
        for (name, kind, limits, motion), state, std, axis, pivot, power in rows
    )


@dataclass(frozen=True)
class PoseEstimate(PosedObject):
    """Shape, pose and joints of one object, as one stage of the estimation has them."""

    joints: tuple[JointEstimate, ...]

    @classmethod
    def of(
        cls, category: Category, posed: Sequence[PosedObject], state_std: np.ndarray, tail: np.ndarray
    ) -> list[PoseEstimate]:
        """Each of B objects, with the joint states' standard deviations (B, J) and tails (B, J)."""
        limits = [(low, high) for low, high in category.metric_limits.tolist()]
        specs = [(j.name, j.type, pair, j.motion) for j, pair in zip(category.joints, limits, strict=True)]
        rows = zip(posed, state_std.tolist(), tail.tolist(), strict=True)
        return [PoseEstimate(**vars(one), joints=_joints(specs, one.placed, *spread)) for one, *spread in rows]

    @property
    def T_camera_part(self) -> np.ndarray:
        """(K, 4, 4) canonical rest coordinates of each part to camera."""
        return self.placed.T_camera_part

    @property
    def T_camera_base(self) -> np.ndarray:
        """(4, 4) canonical base frame to camera."""
        return self.T_camera_part[0]

    @property
    def joint_states(self) -> np.ndarray:
        """(J,)."""
        return np.array([joint.state for joint in self.joints])

    def pose(self) -> ObjectPose:
        """As the metrics take it."""
        return self.placed


@dataclass(frozen=True)
class PartEstimate:
    """One part as seen now."""

    name: str
    T_camera_part: np.ndarray
    """(4, 4) canonical rest coordinates to camera."""
    mesh: Mesh
    """Its surface, canonical space at rest."""
    mesh_in_camera: Mesh
    """Its surface where it is seen, camera frame."""


@dataclass(frozen=True)
class Estimate(PoseEstimate):
    """Shape, pose, joints, keypoints and part labels of one observed object."""

    category: Category
    observed_keypoints: np.ndarray
    """(M, 3) where the network saw them, camera frame: what the model was fitted to."""
    keypoint_std: np.ndarray
    """(M,) expected error of each observed keypoint per coordinate."""
    covariance: np.ndarray
    """(P, P) of (rotation vector, translation, joint states, beta): radians, metres, radians or metres, units."""
    converged: bool
    residual: float
    """RMS distance between model and observed keypoints."""
    labelled: LabelledPoints
    """What the network said of the parts of the observation's points."""
    initial: PoseEstimate
    """The network's own answer, before any fitting."""
    signals: Signals = field(default_factory=Signals.none)
    """What ``probability`` and the joints' deviations were told by; a batch of one."""
    probability: float | None = None
    """That no joint state is off by more than 10 degrees, or 10 % of the object's diagonal; None where the checkpoint
    holds no ``confidence.json``."""
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    surfaces: Surfaces | None = field(default=None, repr=False, compare=False)
    """Where its surface comes from; without, parts are hulls of keypoints."""

    @cached_property
    def surface(self) -> PosedSurface:
        """Surfaces of the parts, fitted to what was seen with pose and joint states; worked out at the first time of
        asking. Raises InputError where the weights' surfaces cannot be read."""
        if self.surfaces is None:
            return PosedSurface(self.hulls, self.placed)
        return self.surfaces.fitted(self, self.covariance, self.labelled.points, self.part_labels)

    @property
    def hulls(self) -> tuple[Mesh, ...]:
        """Of each part the convex hull of its keypoints, canonical space at rest."""
        part_of = np.array(self.category.part_of_keypoint)
        return tuple(convex_hull(self.canonical_keypoints[part_of == k]) for k in range(len(self.category.parts)))

    @property
    def parts(self) -> tuple[PartEstimate, ...]:
        """The parts with their surfaces, as ``surface`` has them."""
        specs, surface = self.category.parts, self.surface
        rows = zip(specs, self.T_camera_part, surface.parts, surface.posed(), strict=True)
        return tuple(PartEstimate(spec.name, T, mesh, posed) for spec, T, mesh, posed in rows)

    @property
    def part_labels(self) -> np.ndarray:
        """(N,) part of every point of the observation, -1 for those that are not on the object; worked out at the first
        time of asking."""
        return self.labelled.labels

    @property
    def doubtful(self) -> bool | None:
        """Whether it is rather wrong than right; None where that is not known."""
        return None if self.probability is None else self.probability < DOUBTFUL

    def without_labels(self) -> Self:
        """The same without part labels, for which it keeps the observation's points: for who keeps a great many."""
        return replace(self, labelled=LabelledPoints.none())

    def initial_pose(self) -> ObjectPose:
        """Initial pose, as the metrics take it."""
        return self.initial.placed

    def to_json(self) -> str:
        """The promised JSON object (angles in radians, lengths in metres, camera frame)."""
        return json.dumps(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """What ``to_json`` writes, as plain Python values."""
        counts = np.bincount(self.part_labels[self.part_labels >= 0], minlength=len(self.category.parts))
        parts = zip(self.category.parts, self.T_camera_part, counts, strict=True)
        initial = ("joints", "T_camera_base", "beta")
        return plain(
            {
                "category": self.category.name,
                "converged": self.converged,
                "probability": self.probability,
                "doubtful": self.doubtful,
                "residual": self.residual,
                "beta": self.beta,
                "T_camera_base": self.T_camera_base,
                "joints": self.joints,
                "parts": [{"name": part.name, "T_camera_part": T, "points": count} for part, T, count in parts],
                "keypoints": self.keypoints,
                "initial": {name: getattr(self.initial, name) for name in initial},
                "seconds": self.seconds,
                "warnings": self.warnings,
            }
        )

    def object_model(self, name: str | None = None) -> ObjectModel:
        """The estimated object at rest, with its surfaces."""
        return self._model(self.surface.parts, name)

    def hull_model(self) -> ObjectModel:
        """The estimated object at rest; a part's mesh is the hull of its keypoints."""
        return self._model(self.hulls, None)

    def _model(self, parts: tuple[Mesh, ...], name: str | None) -> ObjectModel:
        limits = np.array([joint.limits for joint in self.joints])
        name = name or f"estimated_{self.category.name}"
        return ObjectModel.of(self.category, name, parts, self.canonical_axes, self.canonical_pivots, limits)

    def save_urdf(self, path: str | Path) -> None:
        """Write the object as URDF (canonical frame as root, zero = rest) and ``state.json`` beside it."""
        path = Path(path)
        write_urdf(self.object_model(path.stem), path)
        states = {joint.name: joint.state for joint in self.joints}
        state = plain({"joint_states": states, "T_camera_base": self.T_camera_base})
        write_json(path.with_name("state.json"), state, indent=1)

    def waypoints(
        self, part: str, point: Any, to_state: float, steps: int = 20, T_world_camera: Any = None
    ) -> np.ndarray:
        """Where a point of a part goes as its reference joint moves from the estimated state to ``to_state``.

        ``point`` (3,), NumPy or torch, is where it is now, in the camera frame, or in the world frame where
        ``T_world_camera`` (4, 4) is given. Returns (steps, 3) in the same frame, the first one ``point`` itself.
        Only this one joint moves; joints above it in the tree stay where they are.
        Raises InputError for a part that does not move and for wrong shapes.
        """
        start = np.eye(4)
        start[:3, 3] = _checked("point", point, (3,))
        return self.waypoint_poses(part, start, to_state, steps, T_world_camera)[:, :3, 3]

    def waypoint_poses(
        self, part: str, T_camera_handle: Any, to_state: float, steps: int = 20, T_world_camera: Any = None
    ) -> np.ndarray:
        """As ``waypoints``, for a frame that is held fast to the part, a gripper at its handle, say.
        ``T_camera_handle`` (4, 4) is its pose now, in the camera (or world) frame -> (steps, 4, 4) in the same
        frame."""
        names = [spec.name for spec in self.category.parts]
        if part not in names[1:]:
            raise InputError(f"part {part!r} does not move: moving parts are {', '.join(names[1:])}")
        if steps < 1:
            raise InputError(f"steps: {steps} is too few; give at least 1")
        if not np.isfinite(to_state):
            raise InputError(f"to_state: {to_state} is no state; give radians or metres")
        start = _checked("T_camera_handle", T_camera_handle, (4, 4))
        T_world = np.eye(4) if T_world_camera is None else _checked("T_world_camera", T_world_camera, (4, 4))
        joint = self.joints[names.index(part) - 1]
        motions = np.stack([joint.motion(travel) for travel in np.linspace(0.0, to_state - joint.state, steps)])
        return T_world @ motions @ np.linalg.inv(T_world) @ start


def _checked(name: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = as_numpy(values)
    if array.shape != shape:
        raise InputError(f"{name}: shape {array.shape} is wrong; give {shape}")
    return array.astype(np.float64)


def _joint_dict(joint: JointEstimate) -> dict[str, Any]:
    values = {**vars(joint), "fraction": joint.fraction}
    known = math.isfinite(joint.state_std)
    values |= {f"interval_{level}": joint.interval(level / 100) if known else None for level in INTERVALS}
    motion = values.pop("unit_motion")
    del values["tail"]
    return values | ({"pitch": 2 * math.pi * motion.slide / motion.turn} if motion.turns and motion.slide else {})


def plain(value: Any) -> Any:
    """As JSON has it: lists for arrays and tuples, and null for an unknown number, since it knows no NaN."""
    if isinstance(value, JointEstimate):
        value = _joint_dict(value)
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
