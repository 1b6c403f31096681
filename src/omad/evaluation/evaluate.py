"""How well an estimator does on views with known truth: the numbers of ``omad eval pose``."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.batches import batched, progress
from omad.common.errors import InputError
from omad.data.rendering.standard_views import View, observe_all, true_pose
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.objects.category import Category
from omad.output.picture import figure, save

from .metrics import PoseErrors, bootstrap_interval, missing_errors, pose_errors, summarise

BATCH = 64
"""Views that are estimated together."""


@dataclass(frozen=True)
class Measured:
    """What summaries ask of one view."""

    object: str
    """Its name."""
    diagonal: float
    """Of its rest box in metres."""
    initial: PoseErrors
    refined: PoseErrors
    seconds: dict[str, float] | None
    """Of its estimate, where there is one."""


@dataclass(frozen=True)
class ViewResult:
    """One view's estimate and its errors."""

    view: View
    estimate: Estimate | None
    """None where the view could not be estimated at all; it counts as missing."""
    initial: PoseErrors
    refined: PoseErrors

    @property
    def measured(self) -> Measured:
        """Without images and answers."""
        seconds = self.estimate.seconds if self.estimate else None
        return Measured(self.view.object, self.view.truth.diagonal, self.initial, self.refined, seconds)


def evaluate(
    estimator: Estimator, views: Iterable[View], total: int | None = None, batch: int = BATCH, to_surface: bool = False
) -> list[ViewResult]:
    """Estimate every view and measure the initial and the refined answer, which may go on towards its surface."""
    shown = batched(progress(views, total), batch)
    return [result for some in shown for result in measure(estimator, some, to_surface)]


def measure(estimator: Estimator, views: list[View], to_surface: bool = False) -> list[ViewResult]:
    """Of one batch."""
    category, observed = estimator.category, observe_all(views)
    found = estimator(list(observed.values()))
    if to_surface:
        found = [estimate.to_surface() for estimate in found]
    estimates = dict(zip(observed, found, strict=True))
    results = []
    for index, view in enumerate(views):
        initial = refined = missing_errors(category)
        if estimate := estimates.get(index):
            truth, boxes = true_pose(view, category), view.truth.part_boxes
            initial = pose_errors(estimate.initial_pose(), truth, boxes, category)
            refined = pose_errors(estimate.pose(), truth, boxes, category)
        results.append(ViewResult(view, estimate, initial, refined))
    return results


def summary(results: Sequence[Measured], category: Category, source: str) -> dict[str, Any]:
    """The promised JSON of ``omad eval pose`` as plain values (degrees where a key says so, else metres). Raises
    InputError where there are no results."""
    if not results:
        raise InputError(f"{source}: none of its views shows enough of an object; check its camera and its images")
    diagonals = np.array([r.diagonal for r in results])
    names = np.array([r.object for r in results])
    times = [r.seconds for r in results if r.seconds]
    refined = [r.refined for r in results]
    by_object = []
    for name in sorted(set(names)):
        own = [errors for errors, whose in zip(refined, names, strict=True) if whose == name]
        by_object.append({"object": name, "refined": summarise(own, diagonals[names == name], category)})
    states = np.stack([errors.joint_state for errors in refined])
    axes = np.degrees([errors.axis for errors in refined])
    return {
        "category": category.name,
        "source": source,
        "objects": len(by_object),
        "views": len(results),
        "failures": sum(errors.missing for errors in refined),
        "metres_per_unit": category.metres_per_unit,
        "initial": summarise([r.initial for r in results], diagonals, category),
        "refined": summarise(refined, diagonals, category),
        "interval": {
            "joint_state_error_deg": _intervals(np.degrees(states), names, category.turning),
            "joint_state_error": _intervals(states, names, [not turns for turns in category.turning]),
            "axis_error_deg": _intervals(axes, names, [True] * axes.shape[1]),
        },
        "by_object": by_object,
        "seconds": {"network": None, "refinement": None} | _medians(times),
    }


def _intervals(values: np.ndarray, names: np.ndarray, of: Sequence[bool]) -> list[tuple[float, float] | None]:
    """Of each column of ``values`` (views, C) that counts, ``of`` (C,)."""
    return [bootstrap_interval(column, names) if counts else None for column, counts in zip(values.T, of, strict=True)]


def failed(results: Sequence[ViewResult]) -> dict[str, int]:
    """Why views could not be estimated, and how many of them each time."""
    reasons = Counter[str]()
    for result in results:
        if result.estimate is None:
            try:
                result.view.observation()
            except InputError as error:
                reasons[re.sub(r"\d+(\.\d+)?", "...", str(error))] += 1
    return dict(reasons)


def _medians(times: list[dict[str, float]]) -> dict[str, float]:
    """Of each step that was taken."""
    steps = dict.fromkeys(key for spent in times for key in spent)
    return {key: float(np.median([spent[key] for spent in times if key in spent])) for key in steps}


def draw_worst(results: list[ViewResult], category: Category, folder: Path, count: int = 6) -> list[str]:
    """Pictures of the views with the largest errors, worst first; returns their paths."""
    drawn = [(r.view, r.estimate, r.refined) for r in results if r.estimate]
    drawn.sort(key=lambda shown: -float(shown[2].axis.max() + shown[2].joint_state.max()))
    paths = [folder / f"worst-{rank}.png" for rank in range(min(count, len(drawn)))]
    for path, (view, estimate, errors) in zip(paths, drawn, strict=False):
        title = f"{view.object}: axis {np.degrees(errors.axis.max()):.1f}° off"
        save(figure(view.observation(), estimate, true_pose(view, category), title), path)
    return [str(path) for path in paths]
