"""The same views spoilt in every way, estimated, and measured against their truth."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.batches import batched, progress
from omad.common.errors import InputError
from omad.data.rendering.spoils.scenes import Scene, draw_scene, scene_of
from omad.data.rendering.spoils.spoil import Spoil, Staging
from omad.data.rendering.spoils.spoiling import spoilt, within_range
from omad.data.rendering.standard_views import View, observe_all, view_seed
from omad.data.source import ViewSource
from omad.estimation.checks import doubts
from omad.estimation.estimator import Estimator
from omad.objects.category import Category
from omad.output.picture import figure, reading, save

from ..evaluate import true_pose
from ..metrics import PoseErrors, missing_errors, pose_errors
from .rows import CLEAN, Row

BATCH = 64
WITHIN_90 = 1.645
"""Standard deviations to both sides that hold 90 % of a normal distribution."""
WRONG_ANGLE, WRONG_SHARE = float(np.radians(10)), 0.1
"""Of a joint state: radians, and a share of the object's diagonal, beyond which an answer is wrong."""

Scenes = Callable[[int, Staging], Scene | None]
"""Scene ``index`` staged so; None where it cannot be."""


@dataclass(frozen=True)
class Measured:
    """One view of one row."""

    index: int
    """Of the view."""
    errors: PoseErrors
    state_std: np.ndarray
    """(J,) radians or metres; NaN where there is no answer."""
    flagged: bool
    """The answer is called doubtful, or there is none."""
    wrong: bool
    """A joint is off by more than 10 degrees, or 10 % of the object's diagonal."""


def scenes_from(source: ViewSource, category: Category, seed: int) -> Scenes:
    """Scenes of a source's models; of its images where it has no models, each with the mask that its labels say."""
    if source.models:

        def draw(index: int, staging: Staging) -> Scene | None:
            drawn = view_seed(index, len(source.models), seed)
            try:
                return draw_scene(source.models[drawn[1]], category, drawn, staging)
            except InputError:  # seen so, it shows too little
                return None

        return draw
    views = [replace(view, seed=(seed, index)) for index, view in enumerate(source.views)]
    return lambda index, staging: scene_of(views[index], category, staging)


def measure(estimator: Estimator, scenes: Scenes, total: int, rows: Mapping[str, Row]) -> dict[str, list[Measured]]:
    """Every row's views, ``total`` of them where all can be staged so; each scene is rendered once for all rows that
    share its staging."""
    found: dict[str, list[Measured]] = {name: [] for name in rows}
    made = progress(_spoilt_views(scenes, total, rows), total * len(rows))
    for some in batched(made, BATCH):
        shown = [(name, index, view) for name, index, view in some if view is not None]
        measured = _measure(estimator, [view for *_, view in shown])
        for (name, index, _), result in zip(shown, measured, strict=True):
            found[name].append(replace(result, index=index))
    return found


def _spoilt_views(scenes: Scenes, total: int, rows: Mapping[str, Row]) -> Iterator[tuple[str, int, View | None]]:
    for index in range(total):
        staged: dict[Staging, Scene | None] = {}
        for name, row in rows.items():
            staging = row.spoil.staging
            if staging not in staged:
                staged[staging] = scenes(index, staging)
            scene = staged[staging]
            seen = scene if scene is not None and within_range(scene, row.spoil) else None
            yield name, index, None if seen is None else spoilt(seen, row.spoil).view


def _measure(estimator: Estimator, views: list[View]) -> Iterator[Measured]:
    category, observed = estimator.category, observe_all(views)
    estimates = dict(zip(observed, estimator(list(observed.values())), strict=True))
    for number, view in enumerate(views):
        errors, std, flagged = missing_errors(category), np.full(len(category.joints), np.nan), True
        if number in estimates:
            estimate = estimates[number]
            errors = pose_errors(estimate.pose(), true_pose(view, category), view.truth.part_boxes, category)
            std = np.array([joint.state_std for joint in estimate.joints])
            flagged = bool(doubts(observed[number], estimate))
        most = np.where(category.turning, WRONG_ANGLE, WRONG_SHARE * view.truth.diagonal)
        yield Measured(number, errors, std, flagged, bool((errors.joint_state > most).any()))


def table(found: Mapping[str, list[Measured]], rows: Mapping[str, Row], category: Category) -> list[dict[str, Any]]:
    """The rows of the table as plain values: errors of all joints together (degrees where a key says so, else metres),
    shares of views, and of joints the share whose truth lies in the 90 % interval. ``ratio``: the mean error to that of
    the same views when clean."""
    clean = {each.index: _relative(each.errors, category) for each in found[CLEAN]}
    made = []
    for name, measured in found.items():
        if not measured:
            continue
        states = np.stack([each.errors.joint_state for each in measured])
        std = np.stack([each.state_std for each in measured])
        relative = np.mean([_relative(each.errors, category) for each in measured])
        turning = np.array(category.turning)
        flagged, wrong = (np.array([getattr(each, key) for each in measured]) for key in ("flagged", "wrong"))
        made.append(
            {
                "row": name,
                "what": rows[name].what,
                "views": len(measured),
                "missing": sum(each.errors.missing for each in measured),
                "joint_state_error_deg": _spread(np.degrees(states[:, turning])),
                "joint_state_error": _spread(states[:, ~turning]),
                "ratio": float(relative / np.mean([clean[each.index] for each in measured])),
                "covered": float((states <= WITHIN_90 * std).mean()),
                "flagged": float(flagged.mean()),
                "wrong": float(wrong.mean()),
                "silently_wrong": float((wrong & ~flagged).mean()),
            }
        )
    return made


def draw_worst(
    estimator: Estimator, scenes: Scenes, found: Mapping[str, list[Measured]], rows: Mapping[str, Row], folder: Path
) -> list[str]:
    """A picture of each row's worst view that has an answer; returns their paths."""
    category, paths = estimator.category, []
    for name, measured in found.items():
        answered = [each for each in measured if not each.errors.missing]
        if not answered:
            continue
        worst = max(answered, key=lambda each: _relative(each.errors, category))
        view = _view(scenes, worst.index, rows[name].spoil)
        seen = view.observation()
        states = zip(worst.errors.joint_state, category.turning, strict=True)
        off = ", ".join(f"{error / reading(turns)[0]:.1f}{reading(turns)[1]}" for error, turns in states)
        title = f"{name}: {view.object}, joint states {off} off, {'' if worst.flagged else 'not '}flagged"
        paths.append(folder / f"{name}.png")
        save(figure(seen, estimator(seen), true_pose(view, category), title), paths[-1])
    return [str(path) for path in paths]


def _view(scenes: Scenes, index: int, spoil: Spoil) -> View:
    scene = scenes(index, spoil.staging)
    assert scene is not None
    return spoilt(scene, spoil).view


def _relative(errors: PoseErrors, category: Category) -> float:
    """Joint state error as a share of what a missing answer counts, mean over joints."""
    return float((errors.joint_state / missing_errors(category).joint_state).mean())


def _spread(errors: np.ndarray) -> dict[str, float] | None:
    """Of errors (views, joints); None where no joint is of this kind."""
    if not errors.size:
        return None
    return {"mean": float(errors.mean()), "median": float(np.median(errors)), "p90": float(np.quantile(errors, 0.9))}
