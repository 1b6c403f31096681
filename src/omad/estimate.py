"""What is known of one observed object: the answer of the estimator, in metres, radians and the camera frame."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from .arrays import as_numpy
from .categories import Category
from .errors import InputError
from .files import write_atomic
from .metrics import ObjectPose
from .objects import Mesh, ObjectModel
from .urdf import write_urdf


@dataclass(frozen=True)
class JointEstimate:
    """One joint as seen now."""

    name: str
    type: str
    state: float
    """Radians or metres; 0 at rest."""
    state_std: float
    """Its standard deviation."""
    limits: tuple[float, float]
    axis: np.ndarray
    """(3,) unit, camera frame."""
    pivot: np.ndarray | None
    """(3,) a point of the axis, camera frame; None for a prismatic joint."""

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
        if self.pivot is None:
            return np.concatenate([np.zeros(3), self.axis])
        return np.concatenate([self.axis, np.cross(self.pivot, self.axis)])

    def motion(self, travel: float) -> np.ndarray:
        """(4, 4) camera to camera: where a point of the moving part is after ``travel`` (radians or metres) more."""
        T = np.eye(4)
        if self.pivot is None:
            T[:3, 3] = travel * self.axis
        else:
            T[:3, :3] = Rotation.from_rotvec(travel * self.axis).as_matrix()
            T[:3, 3] = self.pivot - T[:3, :3] @ self.pivot
        return T


@dataclass(frozen=True)
class InitialEstimate:
    """The network's own answer, before any fitting."""

    joints: tuple[JointEstimate, ...]
    T_camera_base: np.ndarray
    """(4, 4)."""
    beta: np.ndarray
    """(D,)."""
    T_camera_part: np.ndarray
    """(K, 4, 4)."""
    keypoints: np.ndarray
    """(M, 3) camera frame."""


@dataclass(frozen=True)
class Estimate:
    """Shape, pose, joints, keypoints and part labels of one observed object."""

    category: Category
    beta: np.ndarray
    """(D,) shape parameters."""
    T_camera_base: np.ndarray
    """(4, 4) canonical base frame to camera."""
    T_camera_part: np.ndarray
    """(K, 4, 4) canonical rest coordinates of each part to camera."""
    joints: tuple[JointEstimate, ...]
    keypoints: np.ndarray
    """(M, 3) camera frame."""
    canonical_keypoints: np.ndarray
    """(M, 3) canonical space at rest."""
    canonical_axes: np.ndarray
    """(J, 3)."""
    canonical_pivots: np.ndarray
    """(J, 3)."""
    observed_keypoints: np.ndarray
    """(M, 3) where the network saw them, camera frame: what the model was fitted to."""
    keypoint_std: np.ndarray
    """(M,) expected error of each observed keypoint per coordinate."""
    covariance: np.ndarray
    """(P, P) of (rotation vector, translation, joint states, beta): radians, metres, radians or metres, units."""
    converged: bool
    residual: float
    """RMS distance between model and observed keypoints."""
    part_labels: np.ndarray
    """(N,) part of every point of the observation."""
    initial: InitialEstimate
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def joint_states(self) -> np.ndarray:
        """(J,)."""
        return np.array([joint.state for joint in self.joints])

    def pose(self) -> ObjectPose:
        """Refined pose, as the metrics take it."""
        return _pose(self.joints, self.T_camera_part)

    def initial_pose(self) -> ObjectPose:
        """Initial pose, as the metrics take it."""
        return _pose(self.initial.joints, self.initial.T_camera_part)

    def to_json(self) -> str:
        """The promised JSON object (angles in radians, lengths in metres, camera frame)."""
        return json.dumps(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """What ``to_json`` writes, as plain Python values."""
        names = [part.name for part in self.category.parts]
        counts = np.bincount(self.part_labels, minlength=len(names))
        return {
            "category": self.category.name,
            "converged": self.converged,
            "residual": _number(self.residual),
            "beta": _list(self.beta),
            "T_camera_base": _list(self.T_camera_base),
            "joints": [_joint_dict(joint) for joint in self.joints],
            "parts": [
                {"name": name, "T_camera_part": _list(T), "points": int(count)}
                for name, T, count in zip(names, self.T_camera_part, counts, strict=True)
            ],
            "keypoints": _list(self.keypoints),
            "initial": {
                "joints": [_joint_dict(joint) for joint in self.initial.joints],
                "T_camera_base": _list(self.initial.T_camera_base),
                "beta": _list(self.initial.beta),
            },
            "seconds": self.seconds,
            "warnings": list(self.warnings),
        }

    def object_model(self, name: str | None = None) -> ObjectModel:
        """The estimated object at rest. The model knows keypoints, so a part's mesh is their convex hull."""
        part_of = np.array(self.category.part_of_keypoint)
        meshes = [convex_hull(self.canonical_keypoints[part_of == k]) for k in range(len(self.category.parts))]
        return ObjectModel(
            name=name or f"estimated_{self.category.name}",
            category=self.category.name,
            part_names=tuple(part.name for part in self.category.parts),
            parts=tuple(meshes),
            joint_names=tuple(joint.name for joint in self.joints),
            tree=self.category.tree,
            axes=self.canonical_axes,
            pivots=self.canonical_pivots,
            limits=np.array([joint.limits for joint in self.joints]),
        )

    def save_urdf(self, path: str | Path) -> None:
        """Write the object as URDF (canonical frame as root, zero = rest) and ``state.json`` beside it."""
        path = Path(path)
        write_urdf(self.object_model(path.stem), path)
        state = {
            "joint_states": {joint.name: joint.state for joint in self.joints},
            "T_camera_base": _list(self.T_camera_base),
        }
        text = json.dumps(state, indent=1) + "\n"
        write_atomic(path.with_name("state.json"), lambda temporary: temporary.write_text(text))

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

        ``T_camera_handle`` (4, 4) is its pose now, in the camera (or world) frame -> (steps, 4, 4) in the same frame.
        """
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


def _pose(joints: tuple[JointEstimate, ...], T_camera_part: np.ndarray) -> ObjectPose:
    return ObjectPose(
        states=np.array([joint.state for joint in joints]),
        axes=np.stack([joint.axis for joint in joints]),
        pivots=np.stack([np.zeros(3) if joint.pivot is None else joint.pivot for joint in joints]),
        T_camera_part=T_camera_part,
    )


def convex_hull(points: np.ndarray) -> Mesh:
    """Convex hull, oriented outward; a flat set of points is given a little thickness first."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        size = 1e-3 * max(float(np.ptp(points, axis=0).max()), 1e-3)
        points = np.concatenate([points + size * corner for corner in np.vstack([np.eye(3), -np.eye(3)])])
        hull = ConvexHull(points)
    used, faces = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = points[used].astype(np.float64), faces.reshape(-1, 3)
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = (normal * hull.equations[:, :3]).sum(1) < 0
    return Mesh(vertices, np.where(inward[:, None], faces[:, ::-1], faces))


def _checked(name: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = as_numpy(values)
    if array.shape != shape:
        raise InputError(f"{name}: shape {array.shape} is wrong; give {shape}")
    return array.astype(np.float64)


def _joint_dict(joint: JointEstimate) -> dict[str, Any]:
    return {
        "name": joint.name,
        "type": joint.type,
        "state": _number(joint.state),
        "state_std": _number(joint.state_std),
        "limits": list(joint.limits),
        "fraction": _number(joint.fraction),
        "axis": _list(joint.axis),
        "pivot": None if joint.pivot is None else _list(joint.pivot),
    }


def _number(value: float) -> float | None:
    """JSON knows no NaN: an unknown value is null."""
    return float(value) if np.isfinite(value) else None


def _list(values: np.ndarray) -> Any:
    return [_list(v) for v in values] if np.ndim(values) else _number(float(values))
