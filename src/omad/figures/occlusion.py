"""Error against occlusion: by how much of the surface a view hides by itself, and by what is cut away from it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter
from tqdm import tqdm

from ..categories import Category
from ..errors import InputError
from ..evaluation import true_pose
from ..experiments.predictions import Answer
from ..metrics import PoseErrors, missing_errors, pose_errors
from ..observation import Observation
from ..standard_views import View
from .occluders import hidden_share, occlude
from .seen import Seen
from .style import METHOD_COLOURS, METHOD_NAMES, Sheet, styled

SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
BINS = 4
BATCH = 8
"""Views whose occluded copies are estimated together."""

Estimators = Mapping[str, Callable[[Sequence[Observation]], Sequence[Answer]]]
"""``omad``, and ``ancsh`` where it has weights."""


@dataclass(frozen=True)
class Occlusion:
    """Errors of one category's V views, S shares cut away."""

    category: Category
    objects: tuple[str, ...]
    """(V,)."""
    hidden: np.ndarray
    """(V,) share of the surface that the whole view hides; NaN where there is no model."""
    shares: np.ndarray
    """(S,) of the pixels cut away."""
    state: dict[str, np.ndarray]
    """Per method (V, S), mean over joints in degrees; metres where no joint turns."""
    axis: dict[str, np.ndarray]
    """Per method (V, S), mean over joints in degrees."""
    missing: dict[str, int]
    """Per method, how many answers were missing; they count as the worst."""


def measure_occlusion(
    category: Category, estimators: Estimators, views: Iterable[Seen], total: int, seed: int = 0
) -> Occlusion:
    """Estimate every view whole and with each share of ``SHARES`` cut away."""
    objects: list[str] = []
    hidden: list[float] = []
    errors: dict[str, list[list[PoseErrors]]] = {}
    pending: list[list[View]] = []
    rng = np.random.default_rng([seed, 7])
    for seen in tqdm(views, total=total, unit="view", file=sys.stderr, disable=not sys.stderr.isatty()):
        objects.append(seen.view.object)
        hidden.append(np.nan if seen.model is None else hidden_share(seen.view, seen.model))
        pending.append([replace(seen.view, depth=occlude(seen.view.depth, share, rng)) for share in SHARES])
        if len(pending) == BATCH:
            _estimate(category, estimators, pending, errors)
            pending = []
    if pending:
        _estimate(category, estimators, pending, errors)
    return Occlusion(
        category=category,
        objects=tuple(objects),
        hidden=np.array(hidden),
        shares=np.array(SHARES),
        state={name: np.array([[_state(e, category) for e in row] for row in rows]) for name, rows in errors.items()},
        axis={name: np.degrees([[e.axis.mean() for e in row] for row in rows]) for name, rows in errors.items()},
        missing={name: sum(e.missing for row in rows for e in row) for name, rows in errors.items()},
    )


def _state(errors: PoseErrors, category: Category) -> float:
    turns = np.array(category.revolute)
    return float(np.degrees(errors.joint_state[turns].mean()) if turns.any() else errors.joint_state.mean())


def _estimate(
    category: Category,
    estimators: Estimators,
    pending: list[list[View]],
    errors: dict[str, list[list[PoseErrors]]],
) -> None:
    views = [view for copies in pending for view in copies]
    observed: dict[int, Observation] = {}
    for index, view in enumerate(views):
        try:
            observed[index] = Observation.from_depth(view.depth, view.camera)
        except InputError:  # too little of the object is left to be seen
            continue
    for name, estimate in estimators.items():
        answers = dict(zip(observed, estimate(list(observed.values())), strict=True)) if observed else {}
        stages = ("omad_initial", "omad_refined") if name == "omad" else (name,)
        for stage in stages:
            found = []
            for index, view in enumerate(views):
                answer = answers.get(index)
                if answer is None:
                    found.append(missing_errors(category))
                    continue
                pose = answer.initial_pose() if stage == "omad_initial" else answer.pose()
                found.append(pose_errors(pose, true_pose(view, category), view.truth.part_boxes, category))
            size = len(SHARES)
            errors.setdefault(stage, []).extend(found[i : i + size] for i in range(0, len(found), size))


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of an error at P places."""

    place: np.ndarray
    quartiles: np.ndarray
    """(P, 3): lower quartile, median, upper quartile."""
    count: np.ndarray
    """(P,) views."""


def by_share(found: Occlusion, values: np.ndarray) -> Spread:
    """Over the shares cut away; ``values`` (V, S)."""
    return Spread(
        found.shares, np.quantile(values, [0.25, 0.5, 0.75], axis=0).T, np.full(len(found.shares), len(values))
    )


def by_hidden(found: Occlusion, values: np.ndarray, bins: int = BINS) -> Spread | None:
    """Over bins of equally many whole views; ``values`` (V, S). None where nothing is known of the surface."""
    known = np.nonzero(np.isfinite(found.hidden))[0]
    groups = [g for g in np.array_split(known[np.argsort(found.hidden[known])], bins) if len(g)]
    if len(groups) < 2:
        return None
    whole = values[:, 0]
    return Spread(
        place=np.array([np.median(found.hidden[group]) for group in groups]),
        quartiles=np.stack([np.quantile(whole[group], [0.25, 0.5, 0.75]) for group in groups]),
        count=np.array([len(group) for group in groups]),
    )


def record(found: Occlusion) -> dict[str, Any]:
    """The numbers behind a row of the figure; state errors in degrees, or metres where no joint turns."""

    def numbers(spread: Spread | None) -> dict[str, Any] | None:
        if spread is None:
            return None
        return {"share": spread.place.tolist(), "quartiles": spread.quartiles.tolist(), "views": spread.count.tolist()}

    return {
        "category": found.category.name,
        "objects": len(set(found.objects)),
        "views": len(found.objects),
        "state_unit": "deg" if any(found.category.revolute) else "m",
        "missing": found.missing,
        "cut": {n: {"state": numbers(by_share(found, found.state[n])), "axis_deg": numbers(by_share(found, v))}
                for n, v in found.axis.items()},
        "hidden": {n: {"state": numbers(by_hidden(found, found.state[n])), "axis_deg": numbers(by_hidden(found, v))}
                   for n, v in found.axis.items()},
    }  # fmt: skip


def draw(rows: Sequence[Occlusion]) -> Figure:
    """A row a category: joint state and axis angle, each against what the view hides and what is cut away."""
    with styled():
        sheet = Sheet.of(len(rows), 4, 0.66, left=0.66, top=0.36, bottom=0.86, gap=(0.44, 0.3), right=0.12)
        sheet.header(0, "joint state error", 1, above=0.14)
        sheet.header(2, "joint axis error", 3, above=0.14)
        for index, row in enumerate(rows):
            sheet.label(index, row.category.name)
            centimetres = not any(row.category.revolute)
            for pair, errors, unit in ((0, row.state, " cm" if centimetres else "°"), (2, row.axis, "°")):
                scale = 100.0 if unit == " cm" else 1.0
                hidden, cut = sheet.panel(index, pair), sheet.panel(index, pair + 1)
                for name, values in errors.items():
                    _draw_spread(hidden, by_hidden(row, values * scale), name)
                    _draw_spread(cut, by_share(row, values * scale), name)
                for panel in (hidden, cut):
                    _finish(panel, unit)
                cut.set_xticks(SHARES[::2])
                if index == len(rows) - 1:
                    hidden.set_xlabel("surface hidden in the view")
                    cut.set_xlabel("pixels cut away")
        _legend(sheet, [name for name in METHOD_NAMES if any(name in row.axis for row in rows)])
        return sheet.figure


def _draw_spread(panel: Axes, spread: Spread | None, method: str) -> None:
    if spread is None:
        return
    low, middle, high = spread.quartiles.T
    colour = METHOD_COLOURS[method]
    panel.fill_between(spread.place, low, high, color=colour, alpha=0.16, linewidth=0)
    panel.plot(spread.place, middle, color=colour, linewidth=1.6, marker="o", markersize=2.8)


def _finish(panel: Axes, unit: str) -> None:
    panel.grid(True, axis="y")
    panel.set_axisbelow(True)
    panel.set_ylim(bottom=0)
    panel.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}{unit}"))
    panel.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    panel.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def _legend(sheet: Sheet, methods: Sequence[str]) -> None:
    lines = [sheet.figure.axes[0].plot([], [], color=METHOD_COLOURS[name], linewidth=2)[0] for name in methods]
    names = [METHOD_NAMES[name] for name in methods]
    above = (0.5, 0.2 / sheet.figure.get_figheight())
    sheet.figure.legend(
        lines, names, loc="lower center", bbox_to_anchor=above, ncols=len(names), frameon=False, fontsize=8.5
    )
    sheet.note("lines: medians over views · bands: from the lower to the upper quartile")
