"""Errors of estimates against truth (metres and radians), pure functions in NumPy. Nothing is ever dropped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from .geometry import line_distance, point_to_line, rotation_angle, vector_angle


@dataclass(frozen=True)
class ObjectPose:
    """An articulated object in camera space: an estimate or the truth."""

    states: np.ndarray
    """(J,)."""
    axes: np.ndarray
    """(J, 3) unit, camera frame."""
    pivots: np.ndarray
    """(J, 3) a point of each axis, camera frame."""
    T_camera_part: np.ndarray
    """(K, 4, 4) canonical rest coordinates to camera."""


@dataclass(frozen=True)
class PoseErrors:
    """Errors on one view."""

    joint_state: np.ndarray
    """(J,) radians or metres."""
    axis: np.ndarray
    """(J,) radians between directed axes."""
    axis_distance: np.ndarray
    """(J,) metres between axis lines; NaN for prismatic joints."""
    pivot_distance: np.ndarray
    """(J,) metres from the estimated pivot to the true axis; NaN for prismatic joints."""
    rotation: np.ndarray
    """(K,) radians."""
    translation: np.ndarray
    """(K,) metres between estimated and true place of the part's rest-box centre."""
    missing: bool = False
    """The estimate had no answer; the worst was counted instead."""

    def within(self, angle: float, length: float) -> bool:
        """Every part within ``angle`` radians and ``length`` metres."""
        return bool((self.rotation <= angle).all() and (self.translation <= length).all())


def pose_errors(estimate: ObjectPose, truth: ObjectPose, part_boxes: np.ndarray, revolute: np.ndarray, unit: float):
    """Errors of an estimate; ``part_boxes`` (K, 2, 3) at rest, ``revolute`` (J,) bool, ``unit`` metres per unit.

    An estimate that is not finite counts as missing: 90 degrees and one category unit everywhere.
    """
    parts = (estimate.states, estimate.axes, estimate.pivots, estimate.T_camera_part)
    if not all(np.isfinite(values).all() for values in parts):
        return missing_errors(len(part_boxes), revolute, unit)
    a, b = (_tensors(pose) for pose in (estimate, truth))
    only = np.where(revolute, 1.0, np.nan)
    centres = torch.as_tensor(part_boxes.mean(1))
    places = [_place(pose["T"], centres) for pose in (a, b)]
    return PoseErrors(
        joint_state=np.abs(estimate.states - truth.states),
        axis=vector_angle(a["axes"], b["axes"]).numpy(),
        axis_distance=line_distance(a["axes"], a["pivots"], b["axes"], b["pivots"]).numpy() * only,
        pivot_distance=point_to_line(a["pivots"], b["axes"], b["pivots"]).numpy() * only,
        rotation=rotation_angle(a["T"][:, :3, :3], b["T"][:, :3, :3]).numpy(),
        translation=(places[0] - places[1]).norm(dim=-1).numpy(),
    )


def missing_errors(num_parts: int, revolute: np.ndarray, unit: float) -> PoseErrors:
    """What a missing answer counts as."""
    angle, joints = np.pi / 2, np.ones(len(revolute))
    length = np.where(revolute, unit, np.nan)
    return PoseErrors(
        joint_state=np.where(revolute, angle, unit),
        axis=angle * joints,
        axis_distance=length,
        pivot_distance=length,
        rotation=np.full(num_parts, angle),
        translation=np.full(num_parts, unit),
        missing=True,
    )


def summarise(errors: list[PoseErrors], diagonals: np.ndarray, revolute: np.ndarray) -> dict:
    """Mean, median and 90th percentile of each error over views; ``diagonals`` (views,) of the objects in metres."""
    state = np.stack([e.joint_state for e in errors])
    axis_distance = np.stack([e.axis_distance for e in errors])
    pivot_distance = np.stack([e.pivot_distance for e in errors])
    joints = range(len(revolute))
    close = [e.within(np.radians(5), 0.05 * d) for e, d in zip(errors, diagonals, strict=True)]
    return {
        "joint_state_error_deg": [_spread(np.degrees(state[:, j])) if revolute[j] else None for j in joints],
        "joint_state_error": [None if revolute[j] else _spread(state[:, j]) for j in joints],
        "axis_error_deg": _columns(np.degrees([e.axis for e in errors])),
        "axis_distance": [_spread(axis_distance[:, j]) if revolute[j] else None for j in joints],
        "pivot_distance": [_spread(pivot_distance[:, j]) if revolute[j] else None for j in joints],
        "rotation_error_deg": _columns(np.degrees([e.rotation for e in errors])),
        "translation_error": _columns(np.array([e.translation for e in errors])),
        "within_5deg_5percent": float(np.mean(close)),
    }


def bootstrap_interval(values: np.ndarray, groups: np.ndarray, draws: int = 1000, seed: int = 0) -> tuple[float, float]:
    """95 % interval of the mean of ``values`` (n,) when whole ``groups`` (n,) (objects) are resampled."""
    names = np.unique(groups)
    means = np.array([values[groups == name].mean() for name in names])
    counts = np.array([(groups == name).sum() for name in names])
    picked = np.random.default_rng(seed).integers(0, len(names), (draws, len(names)))
    resampled = (means[picked] * counts[picked]).sum(1) / counts[picked].sum(1)
    low, high = np.quantile(resampled, [0.025, 0.975])
    return float(low), float(high)


def _columns(values: np.ndarray) -> list[dict[str, float]]:
    return [_spread(column) for column in np.asarray(values).T]


def _spread(values: np.ndarray) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p90": float(np.quantile(values, 0.9)),
    }


def _tensors(pose: ObjectPose) -> dict[str, torch.Tensor]:
    return {
        "axes": torch.as_tensor(pose.axes, dtype=torch.float64),
        "pivots": torch.as_tensor(pose.pivots, dtype=torch.float64),
        "T": torch.as_tensor(pose.T_camera_part, dtype=torch.float64),
    }


def _place(T: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    return (T[:, :3, :3] @ points[..., None]).squeeze(-1) + T[:, :3, 3]
