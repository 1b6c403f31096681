"""Errors of estimates against truth (metres and radians), pure functions in NumPy. Nothing is ever dropped."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from omad.estimation.confidence.model import right_within
from omad.geometry.rigid import carry_each
from omad.geometry.transforms import line_distance, point_to_line, rotation_angle, vector_angle
from omad.objects.category import Category
from omad.objects.pose import ObjectPose


@dataclass(frozen=True)
class PoseErrors:
    """Errors on one view."""

    joint_state: np.ndarray
    """(J,) radians or metres."""
    axis: np.ndarray
    """(J,) radians between directed axes."""
    axis_distance: np.ndarray
    """(J,) metres between axis lines; NaN where the axis has no place."""
    pivot_distance: np.ndarray
    """(J,) metres from the estimated pivot to the true axis; NaN where the axis has no place."""
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
        """The base is seen the wrong way round; as a missing answer counts, too."""
        return bool(self.rotation[0] >= np.pi / 2)

    def right(self, category: Category, diagonal: float) -> bool:
        """Whether the answer is of use: every joint state within 10 degrees, or 10 % of the object's ``diagonal``."""
        return not self.missing and bool((self.joint_state <= right_within(category, diagonal)).all())

    def within(self, angle: float, length: float) -> bool:
        """Every part within ``angle`` radians and ``length`` metres."""
        return bool((self.rotation <= angle).all() and (self.translation <= length).all())


def pose_errors(estimate: ObjectPose, truth: ObjectPose, part_boxes: np.ndarray, category: Category) -> PoseErrors:
    """Errors of an estimate; ``part_boxes`` (K, 2, 3) at rest. What is not finite in an estimate counts as missing: its
    errors are 90 degrees and one category unit, those of the joints and parts that are there are their own. Where the
    category has a swap symmetry, the labelling that turns the parts less counts."""
    labellings = [estimate, estimate.swapped()] if category.swap_symmetry else [estimate]
    return min((_errors(each, truth, part_boxes, category) for each in labellings), key=lambda e: e.rotation.sum())


def _errors(estimate: ObjectPose, truth: ObjectPose, part_boxes: np.ndarray, category: Category) -> PoseErrors:
    double = partial(torch.as_tensor, dtype=torch.float64)
    axes, pivots, T = map(double, (estimate.axes, estimate.pivots, estimate.T_camera_part))
    true_axes, true_pivots, true_T = map(double, (truth.axes, truth.pivots, truth.T_camera_part))
    only = np.where(category.turning, 1.0, np.nan)
    places = [carry_each(pose.T_camera_part, part_boxes.mean(1)) for pose in (estimate, truth)]
    apart = np.linalg.norm(places[0][:, None] - places[1], axis=-1)  # (K, K) of each found part from each true one
    errors = {
        "joint_state": np.abs(estimate.states - truth.states),
        "axis": vector_angle(axes, true_axes).numpy(),
        "axis_distance": line_distance(axes, pivots, true_axes, true_pivots).numpy() * only,
        "pivot_distance": point_to_line(pivots, true_axes, true_pivots).numpy() * only,
        "rotation": rotation_angle(T[:, :3, :3], true_T[:, :3, :3]).numpy(),
        "translation": apart.diagonal(),
    }
    worst = vars(missing_errors(category))
    missing = any((~np.isfinite(values) & ~np.isnan(worst[name])).any() for name, values in errors.items())
    counted = {name: np.where(np.isfinite(values), values, worst[name]) for name, values in errors.items()}
    swapped = any(apart[k, p.mirror] < apart[k, k] for k, p in enumerate(category.parts) if p.mirror is not None)
    return PoseErrors(**counted, swapped=swapped, missing=missing)


def missing_errors(category: Category) -> PoseErrors:
    """What a missing answer counts as."""
    angle, unit, parts = np.pi / 2, category.metres_per_unit, len(category.parts)
    length = np.where(category.turning, unit, np.nan)
    return PoseErrors(
        joint_state=np.where(category.turning, angle, unit),
        axis=np.full(len(length), angle),
        axis_distance=length,
        pivot_distance=length,
        rotation=np.full(parts, angle),
        translation=np.full(parts, unit),
        missing=True,
    )


def summarise(errors: list[PoseErrors], diagonals: np.ndarray, category: Category) -> dict:
    """Mean, median and 90th percentile of each error over views, and shares of views. ``diagonals`` (views,) of the
    objects in metres. Flipped: the base is more than 90 degrees off."""
    turning, sliding = np.array(category.turning), ~np.array(category.turning)
    states = [e.joint_state for e in errors]
    close = [e.within(np.radians(5), 0.05 * d) for e, d in zip(errors, diagonals, strict=True)]
    return {
        "joint_state_error_deg": _spreads(np.degrees(states), turning),
        "joint_state_error": _spreads(states, sliding),
        "axis_error_deg": _spreads(np.degrees([e.axis for e in errors])),
        "axis_distance": _spreads([e.axis_distance for e in errors], turning),
        "pivot_distance": _spreads([e.pivot_distance for e in errors], turning),
        "rotation_error_deg": _spreads(np.degrees([e.rotation for e in errors])),
        "translation_error": _spreads([e.translation for e in errors]),
        "within_5deg_5percent": float(np.mean(close)),
        "flipped": float(np.mean([e.flipped for e in errors])),
        "swapped": float(np.mean([e.swapped for e in errors])),
    }


def bootstrap_interval(values: np.ndarray, groups: np.ndarray) -> tuple[float, float] | None:
    """95 % interval of the mean of ``values`` (n,) when whole ``groups`` (n,) (objects) are resampled 1000 times; None
    of a single one, which does not tell how others differ."""
    names, counts = np.unique(groups, return_counts=True)
    if len(names) < 2:
        return None
    means = np.array([values[groups == name].mean() for name in names])
    picked = np.random.default_rng(0).integers(0, len(names), (1000, len(names)))
    resampled = (means[picked] * counts[picked]).sum(1) / counts[picked].sum(1)
    low, high = np.quantile(resampled, [0.025, 0.975]).tolist()
    return low, high


def _spreads(values: np.ndarray | list[np.ndarray], of: np.ndarray | bool = True) -> list[dict[str, float] | None]:
    """Of each column of ``values`` (views, C) that counts, ``of`` (C,)."""
    columns = np.transpose(values)
    return [
        {"mean": float(c.mean()), "median": float(np.median(c)), "p90": float(np.quantile(c, 0.9))} if counts else None
        for c, counts in zip(columns, np.broadcast_to(of, len(columns)), strict=True)
    ]
