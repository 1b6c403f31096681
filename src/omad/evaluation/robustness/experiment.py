"""The same views spoilt in every way, estimated, and measured against their truth."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.batches import batched, progress
from omad.common.errors import InputError
from omad.data.procedural import GENERATORS, generate
from omad.data.rendering.rasteriser import NOTHING
from omad.data.rendering.spoils.scenes import SpoilScene, draw_scene, scene_of
from omad.data.rendering.spoils.spoil import Spoil, Staging
from omad.data.rendering.spoils.spoiling import spoilt, within_range
from omad.data.rendering.standard_views import View, observe_all, standard_view, true_pose, view_seed
from omad.data.source import ViewSource
from omad.estimation.checks import HARDLY_SEEN, doubts, is_doubtful
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.objects.category import Category
from omad.objects.category_file import get_category
from omad.output.picture import figure, reading, save
from omad.sensing.observation import Observation

from ..calibration import area_under_roc, expected_calibration_error
from ..metrics import PoseErrors, missing_errors, pose_errors
from .rows import CLEAN, Row

BATCH = 64
LEVELS = (50, 90)
"""Per cent, of the intervals."""

Scenes = Callable[[int, Staging], SpoilScene | None]
"""Scene ``index`` staged so; None where it cannot be."""


@dataclass(frozen=True)
class Measured:
    """One view of one row."""

    index: int
    """Of the view."""
    errors: PoseErrors
    half_widths: np.ndarray
    """(2, J) of the intervals of ``LEVELS`` around the joint states, radians or metres; NaN where there is no
    answer."""
    flagged: bool
    """The answer is called doubtful, or there is none."""
    wrong: bool
    """A joint is off by more than 10 degrees, or 10 % of the object's diagonal."""
    seen: np.ndarray
    """(J,) bool: of the part that the joint moves more than hardly anything shows."""
    probability: float = np.nan
    """That it is not; NaN where there is no answer, or no probability."""


def scenes_from(source: ViewSource, category: Category, seed: int) -> Scenes:
    """Scenes of a source's models; of its images where it has no models, each with its own mask."""
    if source.models:

        def draw(index: int, staging: Staging) -> SpoilScene | None:
            drawn = view_seed(index, len(source.models), seed)
            try:
                return draw_scene(source.models[drawn[1]], category, drawn, staging)
            except InputError:  # seen so, it shows too little
                return None

        return draw
    views = [replace(view, seed=(seed, index)) for index, view in enumerate(source.views)]
    return lambda index, staging: scene_of(views[index], category, staging) if index < len(views) else None


def measure(
    estimator: Estimator, scenes: Scenes, total: int, rows: Mapping[str, Row], to_surface: bool = False
) -> dict[str, list[Measured]]:
    """Every row's views, ``total`` of them where all can be staged so; each scene is rendered once for all rows that
    share its staging. Answers may go on towards their surfaces."""
    found: dict[str, list[Measured]] = {name: [] for name in rows}
    made = progress(_spoilt_views(scenes, total, rows), total * len(rows))
    for some in batched(made, BATCH):
        shown = [(name, index, view) for name, index, view in some if view is not None]
        measured = _measure(estimator, [view for *_, view in shown], to_surface)
        for (name, index, _), result in zip(shown, measured, strict=True):
            found[name].append(replace(result, index=index))
    return found


def _spoilt_views(scenes: Scenes, total: int, rows: Mapping[str, Row]) -> Iterator[tuple[str, int, View | None]]:
    for index in range(total):
        staged: dict[Staging, SpoilScene | None] = {}
        for name, row in rows.items():
            staging = row.spoil.staging
            if staging not in staged:
                staged[staging] = scenes(index, staging)
            scene = staged[staging]
            seen = scene if scene is not None and within_range(scene, row.spoil) else None
            yield name, index, None if seen is None else spoilt(seen, row.spoil).view


def _measure(estimator: Estimator, views: list[View], to_surface: bool) -> Iterator[Measured]:
    category, observed = estimator.category, observe_all(views)
    answers = estimator(list(observed.values()))
    answers = [answer.to_surface() for answer in answers] if to_surface else answers
    estimates = dict(zip(observed, answers, strict=True))
    for number, view in enumerate(views):
        if number not in estimates:
            nothing = np.full((len(LEVELS), len(category.joints)), np.nan)
            yield Measured(number, missing_errors(category), nothing, flagged=True, wrong=True, seen=_seen(view))
            continue
        estimate = estimates[number]
        errors = pose_errors(estimate.pose(), true_pose(view, category), view.truth.part_boxes, category)
        half = np.ptp([[joint.interval(level / 100) for joint in estimate.joints] for level in LEVELS], axis=2) / 2
        wrong = not errors.right(category, view.truth.diagonal)
        told = _flagged(observed[number], estimate), wrong, _seen(view), _probability(estimate)
        yield Measured(number, errors, half, *told)


def _seen(view: View) -> np.ndarray:
    """``Measured.seen``."""
    labels = view.labels if view.mask is None else view.labels[view.mask.astype(bool)]
    counts = np.bincount(labels[labels != NOTHING], minlength=len(view.truth.part_boxes))
    return counts[1:] >= HARDLY_SEEN * max(counts.sum(), 1)


def _flagged(observation: Observation, estimate: Estimate) -> bool:
    return is_doubtful(estimate, doubts(observation, estimate))


def _probability(estimate: Estimate) -> float:
    return np.nan if estimate.probability is None else estimate.probability


def others(estimator: Estimator, total: int, seed: int) -> list[Measured]:
    """So many views of unseen procedural objects of other categories, to which no answer is right."""
    category, found = estimator.category, []
    names = [name for name in GENERATORS if name != category.name]
    views = (_other(names[index % len(names)], index, seed) for index in range(total))
    for some in batched(progress(views, total), BATCH):
        for number, observation in observe_all(view for view in some if view is not None).items():
            estimate = estimator(observation)
            nothing = np.full((len(LEVELS), len(category.joints)), np.nan)
            unseen = np.zeros(len(category.joints), bool)
            told = _flagged(observation, estimate), True, unseen, _probability(estimate)
            found.append(Measured(number, missing_errors(category), nothing, *told))
    return found


def _other(name: str, index: int, seed: int) -> View | None:
    other = get_category(name)
    try:
        return standard_view(generate(other, index, "test", seed), other, (seed, index))
    except InputError:
        return None


def judged(measured: Sequence[Measured]) -> dict[str, Any] | None:
    """Whether probabilities keep their word and tell right from wrong; None where there are none."""
    told = np.array([each.probability for each in measured])
    right = ~np.array([each.wrong for each in measured])
    known = np.isfinite(told)
    if not known.any():
        return None
    told, right = told[known], right[known]
    error, area = expected_calibration_error(told, right), area_under_roc(told, right)
    return {"answers": len(told), "right": float(right.mean()), "calibration_error": error, "area_under_roc": area}


def table(found: Mapping[str, list[Measured]], rows: Mapping[str, Row], category: Category) -> list[dict[str, Any]]:
    """The rows of the table as plain values: errors of all joints together (degrees where a key says so, else metres),
    shares of views, and of joints the shares whose truth lies in the 50 % and the 90 % interval. ``ratio``: the mean
    error to that of the same joints of the same views when clean; ``trusted``: errors and ratio of the answers that are
    not flagged; ``seen``: those of the joints of whose part more than hardly anything shows, and their share."""
    clean = {each.index: _relative(each.errors, category) for each in found[CLEAN]}
    made = []
    for name, measured in found.items():
        if not measured:
            continue
        states = np.stack([each.errors.joint_state for each in measured])
        half = np.stack([each.half_widths for each in measured], 1)
        covered = (states <= half).mean((1, 2)).tolist()
        seen = np.stack([each.seen for each in measured])
        flagged, wrong = (np.array([getattr(each, key) for each in measured]) for key in ("flagged", "wrong"))
        made.append(
            {
                "row": name,
                "what": rows[name].what,
                "views": len(measured),
                "missing": sum(each.errors.missing for each in measured),
                **_errors(measured, clean, category),
                "trusted": _errors([each for each in measured if not each.flagged], clean, category),
                "seen": {"share": float(seen.mean()), **_errors(measured, clean, category, seen)},
                **{f"covered_{level}": share for level, share in zip(LEVELS, covered, strict=True)},
                "flagged": float(flagged.mean()),
                "wrong": float(wrong.mean()),
                "silently_wrong": float((wrong & ~flagged).mean()),
            }
        )
    return made


def draw_worst(
    estimator: Estimator,
    scenes: Scenes,
    found: Mapping[str, list[Measured]],
    rows: Mapping[str, Row],
    folder: Path,
    to_surface: bool = False,
) -> list[str]:
    """A picture of each row's worst view that has an answer, as ``measure`` found it; returns their paths."""
    category, paths = estimator.category, []
    for name, measured in found.items():
        answered = [each for each in measured if not each.errors.missing]
        if not answered:
            continue
        worst = max(answered, key=lambda each: _relative(each.errors, category).mean())
        view = _view(scenes, worst.index, rows[name].spoil)
        seen = view.observation()
        answer = estimator(seen)
        answer = answer.to_surface() if to_surface else answer
        states = zip(worst.errors.joint_state, category.turning, strict=True)
        off = ", ".join(f"{error / reading(turns)[0]:.1f}{reading(turns)[1]}" for error, turns in states)
        title = f"{name}: {view.object}, joint states {off} off, {'' if worst.flagged else 'not '}flagged"
        paths.append(folder / f"{name}.png")
        save(figure(seen, answer, true_pose(view, category), title), paths[-1])
    return [str(path) for path in paths]


def _view(scenes: Scenes, index: int, spoil: Spoil) -> View:
    scene = scenes(index, spoil.staging)
    assert scene is not None
    return spoilt(scene, spoil).view


def _relative(errors: PoseErrors, category: Category) -> np.ndarray:
    """(J,) joint state errors as shares of what a missing answer counts."""
    return errors.joint_state / missing_errors(category).joint_state


def _errors(
    measured: Sequence[Measured], clean: Mapping[int, np.ndarray], category: Category, which: np.ndarray | None = None
) -> dict[str, Any]:
    """Of all joints together, or ``which`` of them (views, J), and the ``ratio`` to the errors of the same joints when
    ``clean``, where these are there; None where there is nothing."""
    turning, shape = np.array(category.turning), (len(measured), len(category.joints))
    which = np.ones(shape, bool) if which is None else which
    states = np.array([each.errors.joint_state for each in measured]).reshape(shape)
    pairs = [
        (_relative(each.errors, category)[joints].sum(), clean[each.index][joints].sum())
        for each, joints in zip(measured, which, strict=True)
        if each.index in clean and joints.any()
    ]
    return {
        "joint_state_error_deg": _spread(np.degrees(states[which & turning])),
        "joint_state_error": _spread(states[which & ~turning]),
        "ratio": float(np.divide(*np.sum(pairs, axis=0))) if pairs else None,
    }


def _spread(errors: np.ndarray) -> dict[str, float] | None:
    """Of errors (N,); None where there are none."""
    if not errors.size:
        return None
    return {"mean": float(errors.mean()), "median": float(np.median(errors)), "p90": float(np.quantile(errors, 0.9))}
