"""How well an estimator does on views with known truth: the numbers of ``omad eval pose``."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from .categories import Category
from .errors import InputError
from .estimate import Estimate
from .estimator import Estimator
from .kinematics import joint_lines, part_transforms
from .metrics import ObjectPose, PoseErrors, bootstrap_interval, missing_errors, pose_errors, summarise
from .observation import Observation
from .report import figure, save
from .standard_views import View


@dataclass(frozen=True)
class ViewResult:
    """One view's estimate and its errors."""

    view: View
    estimate: Estimate | None
    """None where the view could not be estimated at all; it counts as missing."""
    initial: PoseErrors
    refined: PoseErrors


def true_pose(view: View, category: Category) -> ObjectPose:
    """Where the object of a view really is, in camera space."""
    axes, pivots, states, pose = (
        torch.as_tensor(values, dtype=torch.float64)[None]
        for values in (view.truth.axes, view.truth.pivots, view.states, view.T_camera_base)
    )
    G = part_transforms(category.tree, axes, pivots, states, pose)
    lines = joint_lines(category.tree, axes, pivots, G)
    return ObjectPose(view.states, lines.axes[0].numpy(), lines.pivots[0].numpy(), G[0].numpy())


def evaluate(
    estimator: Estimator, views: Iterable[View], total: int | None = None, batch: int = 64
) -> list[ViewResult]:
    """Estimate every view and measure the initial and the refined answer."""
    results: list[ViewResult] = []
    pending: list[View] = []
    bar = tqdm(views, total=total, unit="view", file=sys.stderr, disable=not sys.stderr.isatty())
    for view in bar:
        pending.append(view)
        if len(pending) == batch:
            results += _measure(estimator, pending)
            pending = []
    return results + _measure(estimator, pending)


def _measure(estimator: Estimator, views: list[View]) -> list[ViewResult]:
    category = estimator.category
    observed: dict[int, Observation] = {}
    for index, view in enumerate(views):
        try:
            observed[index] = Observation.from_depth(view.depth, view.camera)
        except InputError:  # too little of the object is left to be seen
            continue
    estimates = dict(zip(observed, estimator(list(observed.values())), strict=True))
    results = []
    for index, view in enumerate(views):
        truth, boxes = true_pose(view, category), view.truth.part_boxes
        estimate = estimates.get(index)
        if estimate is None:
            nothing = missing_errors(category)
            results.append(ViewResult(view, None, nothing, nothing))
            continue
        initial = pose_errors(estimate.initial_pose(), truth, boxes, category)
        refined = pose_errors(estimate.pose(), truth, boxes, category)
        results.append(ViewResult(view, estimate, initial, refined))
    return results


def summary(results: list[ViewResult], category: Category, source: str) -> dict[str, Any]:
    """The promised JSON of ``omad eval pose`` as plain values (degrees where a key says so, else metres)."""
    diagonals = np.array([r.view.truth.diagonal for r in results])
    names = np.array([r.view.object for r in results])
    times = [r.estimate.seconds for r in results if r.estimate]
    by_object = []
    for name in sorted(set(names)):
        own = [r.refined for r in results if r.view.object == name]
        by_object.append({"object": name, "refined": summarise(own, diagonals[names == name], category)})
    state = np.stack([r.refined.joint_state for r in results])
    axis = np.degrees([r.refined.axis for r in results])
    state = np.where(category.revolute, np.degrees(state), state)
    return {
        "category": category.name,
        "source": source,
        "objects": len(by_object),
        "views": len(results),
        "failures": sum(r.refined.missing for r in results),
        "metres_per_unit": category.metres_per_unit,
        "initial": summarise([r.initial for r in results], diagonals, category),
        "refined": summarise([r.refined for r in results], diagonals, category),
        "interval": {
            "joint_state_error": [bootstrap_interval(column, names) for column in state.T],
            "axis_error_deg": [bootstrap_interval(column, names) for column in axis.T],
        },
        "by_object": by_object,
        "seconds": {
            key: float(np.median([t[key] for t in times])) if times else None for key in ("network", "refinement")
        },
    }


def draw_worst(results: list[ViewResult], category: Category, folder: Path, count: int = 6) -> list[str]:
    """Pictures of the views with the largest errors, worst first; returns their paths."""
    drawn = [r for r in results if r.estimate is not None]
    drawn.sort(key=lambda r: -float(r.refined.axis.max() + r.refined.joint_state.max()))
    paths = []
    for rank, result in enumerate(drawn[:count]):
        assert result.estimate is not None
        observation = Observation.from_depth(result.view.depth, result.view.camera)
        worst = f"axis {np.degrees(result.refined.axis.max()):.1f}° off"
        path = folder / f"worst-{rank}.png"
        title = f"{result.view.object}: {worst}"
        save(figure(observation, result.estimate, true_pose(result.view, category), title), path)
        paths.append(str(path))
    return paths
