"""What is known of one observed object: the answer of the estimator, in metres, radians and the camera frame."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import Any, Self

import numpy as np

from omad.common.arrays import number, numbers
from omad.common.errors import InputError
from omad.common.files import write_json
from omad.geometry.mesh import Mesh, convex_hull
from omad.geometry.rigid import rigid_transform
from omad.geometry.transforms import MIRROR_X
from omad.model.fitting.posed_object import PosedObject
from omad.model.surfaces.bank import train_command
from omad.model.surfaces.surfaces import FittedSurface, PosedSurface, Surfaces
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.objects.pose import ObjectPose
from omad.objects.urdf import write_urdf

from .confidence.signals import Signals
from .joint_estimate import JointEstimate, check_state
from .part_labels import LabelledPoints

DOUBTFUL = 0.5
"""Probability of being right below which an answer is called doubtful."""


def _joints(
    category: Category, placed: ObjectPose, state_std: Sequence[float], tail: Sequence[float]
) -> tuple[JointEstimate, ...]:
    """Of one object."""
    specs = zip(category.joints, category.metric_limits.tolist(), strict=True)
    rows = zip(specs, placed.states.tolist(), state_std, placed.axes, placed.pivots, tail, strict=True)
    return tuple(
        JointEstimate(
            joint.name, joint.type, state, std, (low, high), axis, pivot if joint.motion.turns else None, joint.motion,
            power,
        )
        for (joint, (low, high)), state, std, axis, pivot, power in rows
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class PoseEstimate(PosedObject):
    """Shape, pose and joints of one object, as one stage of the estimation has them."""

    joints: tuple[JointEstimate, ...]
    """In the category's order."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {', '.join(map(str, self.joints))}>"

    @classmethod
    def of(
        cls, category: Category, posed: Sequence[PosedObject], state_std: np.ndarray, tail: np.ndarray
    ) -> list[PoseEstimate]:
        """Each of B objects, with the joint states' standard deviations (B, J) and tails (B, J)."""
        rows = zip(posed, state_std.tolist(), tail.tolist(), strict=True)
        return [PoseEstimate(**vars(one), joints=_joints(category, one.placed, *spread)) for one, *spread in rows]

    def reflected(self, turning: Sequence[bool]) -> Self:
        return replace(super().reflected(turning), joints=tuple(joint.mirrored() for joint in self.joints))

    @property
    def T_camera_part(self) -> np.ndarray:
        """(K, 4, 4) canonical rest coordinates of each part to camera."""
        return self.placed.T_camera_part.copy()

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


@dataclass(frozen=True, eq=False)
class PartEstimate:
    """One part as seen now."""

    name: str
    """As in the category."""
    T_camera_part: np.ndarray
    """(4, 4) canonical rest coordinates to camera."""
    mesh: Mesh
    """Its surface, canonical space at rest: ``T_camera_part`` carries it to ``mesh_in_camera``."""
    mesh_in_camera: Mesh
    """Its surface where it is seen, camera frame."""

    def __repr__(self) -> str:
        x, y, z = self.T_camera_part[:3, 3]
        return f"<PartEstimate: {self.name} at ({x:.3f}, {y:.3f}, {z:.3f}) m>"


@dataclass(frozen=True, eq=False)
class Estimate(PoseEstimate):
    """Shape, pose, joints, keypoints and part labels of one observed object."""

    category: Category
    """What it was taken for."""
    observed_keypoints: np.ndarray
    """(M, 3) where the network saw them, camera frame: what the model was fitted to."""
    keypoint_std: np.ndarray
    """(M,) expected error of each observed keypoint per coordinate."""
    covariance: np.ndarray
    """(P, P) of (rotation vector, translation, joint states, beta): radians, metres, radians or metres, units."""
    base_std: np.ndarray
    """(6,) standard deviations of the base's rotation vector and translation in camera axes, radians and metres."""
    converged: bool
    """Whether the least squares came to rest."""
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
    """How long each step took: ``network``, ``refinement``; ``surface`` where it went on towards its surface, and on
    the command line and over HTTP ``read``."""
    warnings: tuple[str, ...] = ()
    """What a person should know before trusting it."""
    joints_alone: tuple[JointEstimate, ...] = ()
    """What this view says of the joints without the others, where it is one of several of one object."""
    surfaces: Surfaces | None = None
    """Where its surface comes from; without, parts are hulls of keypoints."""
    of_other_hand: bool = False
    """The object is the mirror image of what the category's spec describes, and of what ``beta`` says: its door is
    hinged on the other side, say. All else is of the object itself."""
    hand_probability: float | None = None
    """That this is so, or not so, as ``of_other_hand`` says; None where the category has one hand only, or where nobody
    learned how to tell."""

    @property
    def mirrored_probability(self) -> float | None:
        """That it is of the other hand; None as ``hand_probability``."""
        told = self.hand_probability
        return told if told is None or self.of_other_hand else 1 - told

    def in_mirror(self) -> Self:
        """The answer to what is seen in a mirror in the camera's plane x = 0."""
        sign = np.concatenate([[1.0, -1.0, -1.0], MIRROR_X, np.ones(len(self.covariance) - 6)])
        turning = self.category.turning
        return replace(
            self.reflected(turning),
            observed_keypoints=self.observed_keypoints * MIRROR_X,
            covariance=sign[:, None] * self.covariance * sign,
            labelled=replace(self.labelled, points=self.labelled.points * np.array(MIRROR_X, np.float32)),
            initial=self.initial.reflected(turning),
            joints_alone=tuple(joint.mirrored() for joint in self.joints_alone),
            of_other_hand=not self.of_other_hand,
        )

    def __repr__(self) -> str:
        """What a person wants to know first: the joints, and how sure they are."""
        x, y, z = self.T_camera_base[:3, 3]
        told = [", ".join(map(str, self.joints)), f"base at ({x:.3f}, {y:.3f}, {z:.3f}) m"]
        if self.probability is not None:
            told.append(f"right with probability {chance(self.probability)}")
        told += ["not converged"] * (not self.converged)
        told += [f"warned of {', '.join(text.partition(':')[0] for text in self.warnings)}"] * bool(self.warnings)
        return f"<Estimate of a {self.category.name}: {'; '.join(told)}>"

    @cached_property
    def surface(self) -> PosedSurface:
        """Surfaces of the parts, fitted to what was seen; ``T_camera_part`` carries them there. Worked out at the
        first time of asking. Raises InputError where the weights' surfaces cannot be read."""
        if self.surfaces is None:
            return PosedSurface(self.hulls, self.placed, self.placed)
        if self.of_other_hand:
            return self.in_mirror().surface.mirrored(self.category.turning)
        return self.surfaces.fitted(self, self.covariance, self.labelled.points, self.part_labels)

    def to_surface(self) -> Self:
        """The answer with its pose, shape and joint states so far towards those of the fit to its surface as was best
        on views that the network had not seen; axes and keypoints follow, and deviations shrink as errors did there.
        Takes as long as ``surface``; once there, an answer stays. Of several views of one object each goes its own way.
        Raises InputError where these weights have no surfaces, or how far was not measured."""
        if self.of_other_hand:
            return self.in_mirror().to_surface().in_mirror()
        shares = None if self.surfaces is None else self.surfaces.bank.shares
        if self.surfaces is None or shares is None:
            cure = train_command(self.category)
            raise InputError(f"to_surface: whether it helps was not measured for these weights; run {cure}")
        if "surface" in self.seconds or not shares.taken.any() or not self.is_finite:
            return self
        began, fitted = time.perf_counter(), self.surface
        assert isinstance(fitted, FittedSurface)
        if not fitted.step.any():  # no point of the object to fit to, as without labels
            return self
        size, joints = len(self.covariance), len(self.joints)
        posed = self.surfaces.towards(self, fitted, shares.of_unknowns(shares.taken, size))
        shrinkage = shares.of_unknowns(shares.shrinkage, size)
        [found] = PoseEstimate.of(
            self.category,
            [posed],
            np.array([[joint.state_std for joint in self.joints]]) * shrinkage[6 : 6 + joints],
            np.array([[joint.tail for joint in self.joints]]),
        )
        covariance = shrinkage[:, None] * self.covariance * shrinkage
        there = self.placed_as(found, covariance, shrinkage[:6] * self.base_std)
        return replace(there, seconds=self.seconds | {"surface": time.perf_counter() - began})

    def placed_as(self, found: PoseEstimate, covariance: np.ndarray, base_std: np.ndarray) -> Self:
        """The answer with another shape, pose and joint states, of ``covariance`` (P, P) and ``base_std`` (6,)."""
        residual = float(np.sqrt(np.square(found.keypoints - self.observed_keypoints).sum(1).mean()))
        return replace(self, **vars(found), covariance=covariance, base_std=base_std, residual=residual)

    @cached_property
    def hulls(self) -> tuple[Mesh, ...]:
        """Of each part the convex hull of its keypoints, canonical space at rest."""
        part_of = np.array(self.category.part_of_keypoint)
        return tuple(convex_hull(self.canonical_keypoints[part_of == k]) for k in range(len(self.category.parts)))

    @property
    def parts(self) -> tuple[PartEstimate, ...]:
        """The parts with their surfaces, as ``surface`` has them."""
        specs, surface = self.category.parts, self.surface
        rows = zip(specs, self.T_camera_part, surface.parts, surface.posed(), strict=True)
        return tuple(PartEstimate(spec.name, T.copy(), mesh, posed) for spec, T, mesh, posed in rows)

    @property
    def part_labels(self) -> np.ndarray:
        """(N,) part of every point of the observation, -1 for those that are not on the object; worked out at the first
        time of asking."""
        return self.labelled.labels

    @property
    def is_finite(self) -> bool:
        """Whether it is an answer at all: of a cloud many times larger than the category there may be no numbers."""
        return bool(np.isfinite(self.keypoints).all())

    @property
    def expected_error(self) -> float:
        """Of a keypoint as the network sees it, the geometric mean over them, metres."""
        return float(np.exp(np.log(self.keypoint_std).mean()))

    @property
    def supposed_probability(self) -> float:
        """Of being right; 1 where the weights do not tell, as nothing speaks against it."""
        return 1.0 if self.probability is None else self.probability

    @property
    def doubtful(self) -> bool | None:
        """Whether it is rather wrong than right; None where that is not known."""
        return None if self.probability is None else self.probability < DOUBTFUL

    def without_labels(self) -> Self:
        """The same without part labels, for which it keeps the observation's points: for who keeps a great many. How
        many points a part has is null in its JSON then, and its surface is no longer fitted to what was seen."""
        return replace(self, labelled=LabelledPoints.none())

    def initial_pose(self) -> ObjectPose:
        """Initial pose, as the metrics take it."""
        return self.initial.placed

    def to_json(self) -> str:
        """The promised JSON object (angles in radians, lengths in metres, camera frame)."""
        return json.dumps(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """What ``to_json`` writes, as plain Python values."""
        labels, named = self.part_labels, self.category.parts
        counts = np.bincount(labels[labels >= 0], minlength=len(named)) if len(labels) else [None] * len(named)
        parts = zip(named, self.T_camera_part, counts, strict=True)
        initial = ("joints", "T_camera_base", "beta")
        return plain(
            {
                "category": self.category.name,
                "converged": self.converged,
                "probability": self.probability,
                "doubtful": self.doubtful,
                "residual": self.residual,
                "mirrored": self.of_other_hand,
                "hand_probability": self.hand_probability,
                "beta": self.beta,
                "T_camera_base": self.T_camera_base,
                "base_std": self.base_std,
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

    def carried_model(self) -> ObjectModel:
        """The estimated object at rest; its surfaces are those of the known object with the nearest keypoints, carried
        along but not fitted to what was seen: that takes a tenth of the time."""
        if self.surfaces is None:
            return self.hull_model()
        if self.of_other_hand:
            parts = self.surfaces.of_keypoints(self.canonical_keypoints * MIRROR_X)
            return self._model(tuple(part.mirrored() for part in parts), None)
        return self._model(self.surfaces.of_keypoints(self.canonical_keypoints), None)

    def hull_model(self) -> ObjectModel:
        """The estimated object at rest; a part's mesh is the hull of its keypoints."""
        return self._model(self.hulls, None)

    def _model(self, parts: tuple[Mesh, ...], name: str | None) -> ObjectModel:
        limits = np.array([joint.limits for joint in self.joints])
        name = name or f"estimated_{self.category.name}"
        return ObjectModel.of(self.category, name, parts, self.canonical_axes, self.canonical_pivots, limits)

    def save_urdf(self, path: str | Path) -> None:
        """Write the object as URDF (canonical frame as root, zero = rest; a ``.urdf`` file, or ``model.urdf`` in a
        folder) and ``state.json`` beside it, in place of that of an object saved there before: give each a folder."""
        file = write_urdf(self.object_model(Path(path).stem or None), path)
        states = {joint.name: joint.state for joint in self.joints}
        state = plain({"joint_states": states, "T_camera_base": self.T_camera_base})
        write_json(file.with_name("state.json"), state, indent=1)

    def waypoints(
        self, part: str, point: Any, to_state: float, steps: int = 20, T_world_camera: Any = None
    ) -> np.ndarray:
        """Where a point of a part goes as its reference joint moves from the estimated state to ``to_state``.

        ``point`` (3,), NumPy or torch, is where it is now, in the camera frame, or in the world frame where
        ``T_world_camera`` (4, 4) is given. Returns (steps, 3) in the same frame, the first one ``point`` itself.
        Only this one joint moves; joints above it in the tree stay where they are.
        Raises InputError for a part that does not move, for wrong shapes and for what is not finite.
        """
        start = np.eye(4)
        start[:3, 3] = numbers(point, 3, what="point")
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
        if not isinstance(steps, Integral) or steps < 1:
            raise InputError(f"steps: {steps} is no number of poses; give at least 1")
        if not math.isfinite(state := number(to_state)):
            raise InputError(f"to_state: {to_state} is no state; give radians or metres")
        start = rigid_transform(T_camera_handle, "T_camera_handle")
        T_world = np.eye(4) if T_world_camera is None else rigid_transform(T_world_camera, "T_world_camera")
        joint = self.joints[names.index(part) - 1]
        check_state(state, joint.limits, "to_state")
        motions = np.stack([joint.motion(travel) for travel in np.linspace(0.0, state - joint.state, steps)])
        return T_world @ motions @ np.linalg.inv(T_world) @ start


def chance(probability: float) -> str:
    """A probability as a person reads it; nothing is quite sure."""
    return f"{min(max(probability, 0.01), 0.99):.0%}"


def plain(value: Any) -> Any:
    """As JSON has it: lists for arrays and tuples, and null for an unknown number, since it knows no NaN."""
    if isinstance(value, JointEstimate):
        value = value.to_dict()
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def total_seconds(estimates: Sequence[Estimate]) -> dict[str, float]:
    """How long each step took for all estimates together."""
    return {key: sum(estimate.seconds[key] for estimate in estimates) for key in estimates[0].seconds}
