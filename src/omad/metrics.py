"""Errors of estimates against truth (metres and radians), pure functions in NumPy. Nothing is ever dropped."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from .categories import Category
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

    def swapped(self) -> ObjectPose:
        """The same object with its two parts' names exchanged, turned half about z (``Category.swap_symmetry``)."""
        return replace(self, axes=-self.axes, T_camera_part=self.T_camera_part[::-1] @ np.diag([-1.0, -1.0, 1.0, 1.0]))


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
    swapped: bool = False
    """Parts that are each other's mirror image were taken for each other."""
    missing: bool = False
    """The estimate had no answer, or not for every joint and part; the worst was counted where it had none."""

    @property
    def flipped(self) -> bool:
        """The base is seen the wrong way round."""
        return bool(self.rotation[0] > np.pi / 2)

    def within(self, angle: float, length: float) -> bool:
        """Every part within ``angle`` radians and ``length`` metres."""
        return bool((self.rotation <= angle).all() and (self.translation <= length).all())


def pose_errors(estimate: ObjectPose, truth: ObjectPose, part_boxes: np.ndarray, category: Category) -> PoseErrors:
    """Errors of an estimate; ``part_boxes`` (K, 2, 3) at rest.

    What is not finite in an estimate counts as missing: its errors are 90 degrees and one category unit, those of the
    joints and parts that are there are their own. Where the category has a swap symmetry, the labelling that turns the
    parts less counts.
    """
    labellings = [estimate, estimate.swapped()] if category.swap_symmetry else [estimate]
    errors = [_worst_where_missing(_errors(each, truth, part_boxes, category), category) for each in labellings]
    return min(errors, key=lambda e: e.rotation.sum())


def _worst_where_missing(errors: PoseErrors, category: Category) -> PoseErrors:
    worst = missing_errors(category)
    names = ("joint_state", "axis", "axis_distance", "pivot_distance", "rotation", "translation")
    counted = {n: np.where(np.isfinite(getattr(errors, n)), getattr(errors, n), getattr(worst, n)) for n in names}
    missing = any((np.isnan(getattr(errors, n)) & ~np.isnan(getattr(worst, n))).any() for n in names)
    return replace(errors, **counted, missing=missing)


def _errors(estimate: ObjectPose, truth: ObjectPose, part_boxes: np.ndarray, category: Category) -> PoseErrors:
    a, b = (_tensors(pose) for pose in (estimate, truth))
    only = np.where(category.revolute, 1.0, np.nan)
    centres = torch.as_tensor(part_boxes.mean(1))
    found, true = (_place(pose["T"], centres) for pose in (a, b))
    partners = [(k, part.mirror) for k, part in enumerate(category.parts) if part.mirror not in (k, None)]
    return PoseErrors(
        joint_state=np.abs(estimate.states - truth.states),
        axis=vector_angle(a["axes"], b["axes"]).numpy(),
        axis_distance=line_distance(a["axes"], a["pivots"], b["axes"], b["pivots"]).numpy() * only,
        pivot_distance=point_to_line(a["pivots"], b["axes"], b["pivots"]).numpy() * only,
        rotation=rotation_angle(a["T"][:, :3, :3], b["T"][:, :3, :3]).numpy(),
        translation=(found - true).norm(dim=-1).numpy(),
        swapped=any(bool((found[k] - true[other]).norm() < (found[k] - true[k]).norm()) for k, other in partners),
    )


def missing_errors(category: Category) -> PoseErrors:
    """What a missing answer counts as."""
    angle, unit = np.pi / 2, category.metres_per_unit
    revolute, num_parts = np.array(category.revolute), len(category.parts)
    length = np.where(revolute, unit, np.nan)
    return PoseErrors(
        joint_state=np.where(revolute, angle, unit),
        axis=np.full(len(revolute), angle),
        axis_distance=length,
        pivot_distance=length,
        rotation=np.full(num_parts, angle),
        translation=np.full(num_parts, unit),
        missing=True,
    )


def summarise(errors: list[PoseErrors], diagonals: np.ndarray, category: Category) -> dict:
    """Mean, median and 90th percentile of each error over views, and shares of views.

    ``diagonals`` (views,) of the objects in metres. Flipped: the base is more than 90 degrees off.
    """
    revolute = category.revolute
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
        "flipped": float(np.mean([e.flipped for e in errors])),
        "swapped": float(np.mean([e.swapped for e in errors])),
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
