"""Error against occlusion: by how much of the surface a view hides by itself, and by what is cut away from it."""

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter

from omad.common.batches import batched, progress
from omad.data.rendering.rasteriser import NOTHING, render
from omad.data.rendering.standard_views import View, observe_all, true_pose
from omad.data.source import ViewSource
from omad.geometry.rigid import carry_each
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.sensing.observation import Observation

from ..metrics import PoseErrors, missing_errors, pose_errors
from ..paper.predictions import Answer
from .style import METHOD_COLOURS, METHOD_NAMES, Sheet, styled

SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
BINS = 4
QUARTILES = (0.25, 0.5, 0.75)
BATCH = 8
"""Views whose occluded copies are estimated together."""

SURFACE_POINTS = 4000
DEPTH_SLACK = 0.01
"""Of the object's diagonal: a surface point this near to the depth image is seen."""

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


def hidden_share(view: View, model: ObjectModel) -> float:
    """Share of the object's surface, both sides and inner walls included, that the view does not show."""
    surface = model.surface_samples(SURFACE_POINTS, np.random.default_rng(0))
    T = model.part_transforms(view.states, view.T_camera_base)[surface.labels]
    points = carry_each(T, surface.points.astype(np.float64))
    camera = view.camera
    depth = render(model, view.states, view.T_camera_base, camera).depth
    columns, rows = np.rint(camera.project(points)).astype(int).T
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    nearest = depth[np.where(inside, rows, 0), np.where(inside, columns, 0)]
    seen = inside & (nearest > 0) & (np.abs(points[:, 2] - nearest) < DEPTH_SLACK * view.truth.diagonal)
    return 1 - float(seen.mean())


def occlude(depth: np.ndarray, thing: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """``depth`` (H, W) without ``share`` of the measured pixels of a ``thing`` (H, W) bool: those on one side of a
    random line, or those in a random box around one of them."""
    rows, columns = np.nonzero(depth * thing)
    if share <= 0 or not len(rows):
        return depth
    if rng.random() < 0.5:
        angle = rng.uniform(0, 2 * np.pi)
        order = np.cos(angle) * columns + np.sin(angle) * rows
    else:
        middle, stretch = rng.integers(len(rows)), np.exp(rng.uniform(-0.7, 0.7))
        order = np.maximum(np.abs(columns - columns[middle]) * stretch, np.abs(rows - rows[middle]) / stretch)
    taken = np.argsort(order, kind="stable")[: round(share * len(rows))]
    left = depth.copy()
    left[rows[taken], columns[taken]] = 0
    return left


def measure_occlusion(category: Category, estimators: Estimators, source: ViewSource, seed: int = 0) -> Occlusion:
    """Estimate every view of a source whole and with each share of ``SHARES`` cut away."""
    objects: list[str] = []
    hidden: list[float] = []
    errors: dict[str, list[list[PoseErrors]]] = defaultdict(list)
    rng = np.random.default_rng([seed, 7])
    for some in batched(progress(source.views, source.total), BATCH):
        objects += [view.object for view in some]
        hidden += [hidden_share(view, model) if (model := source.model_of(view)) else np.nan for view in some]
        cut = [
            replace(view, depth=occlude(view.depth, view.labels != NOTHING, share, rng))
            for view in some
            for share in SHARES
        ]
        for stage, found in _estimate(category, estimators, cut).items():
            errors[stage] += batched(found, len(SHARES))
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
    turns = np.array(category.turning)
    return float(np.degrees(errors.joint_state[turns].mean()) if turns.any() else errors.joint_state.mean())


def _estimate(category: Category, estimators: Estimators, views: Sequence[View]) -> dict[str, list[PoseErrors]]:
    """Errors of every method on every view, those of a missing answer where too little of the object is left."""
    observed = observe_all(views)
    truths = [true_pose(view, category) for view in views]
    errors: dict[str, list[PoseErrors]] = {}
    for name, estimate in estimators.items():
        answers = estimate(list(observed.values())) if observed else []
        stages = {name: [answer.pose() for answer in answers]}
        if name == "omad":
            stages = {"omad_initial": [answer.initial_pose() for answer in answers], "omad_refined": stages[name]}
        for stage, poses in stages.items():
            errors[stage] = [missing_errors(category)] * len(views)
            for index, pose in zip(observed, poses, strict=True):
                errors[stage][index] = pose_errors(pose, truths[index], views[index].truth.part_boxes, category)
    return errors


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
    quartiles = np.quantile(values, QUARTILES, axis=0).T
    return Spread(found.shares, quartiles, np.full(len(found.shares), len(values)))


def by_hidden(found: Occlusion, values: np.ndarray) -> Spread | None:
    """Over bins of equally many whole views; ``values`` (V, S). None where nothing is known of the surface."""
    known = np.nonzero(np.isfinite(found.hidden))[0]
    groups = [g for g in np.array_split(known[np.argsort(found.hidden[known])], BINS) if len(g)]
    if len(groups) < 2:
        return None
    return Spread(
        place=np.array([np.median(found.hidden[group]) for group in groups]),
        quartiles=np.stack([np.quantile(values[group, 0], QUARTILES) for group in groups]),
        count=np.array([len(group) for group in groups]),
    )


def record(found: Occlusion) -> dict[str, Any]:
    """The numbers behind a row of the figure; state errors in degrees, or metres where no joint turns."""

    def numbers(by: Callable[[Occlusion, np.ndarray], Spread | None], values: np.ndarray) -> dict[str, Any] | None:
        if (spread := by(found, values)) is None:
            return None
        return {"share": spread.place.tolist(), "quartiles": spread.quartiles.tolist(), "views": spread.count.tolist()}

    cut, hidden = (
        {name: {"state": numbers(by, found.state[name]), "axis_deg": numbers(by, found.axis[name])}
         for name in found.axis}
        for by in (by_share, by_hidden)
    )  # fmt: skip
    return {
        "category": found.category.name,
        "objects": len(set(found.objects)),
        "views": len(found.objects),
        "state_unit": "deg" if any(found.category.turning) else "m",
        "missing": found.missing,
        "cut": cut,
        "hidden": hidden,
    }


@styled
def draw(rows: Sequence[Occlusion]) -> Figure:
    """A row a category: joint state and axis angle, each against what the view hides and what is cut away."""
    sheet = Sheet.of(len(rows), 4, 0.66, left=0.66, top=0.36, bottom=0.86, gap=(0.44, 0.3), right=0.12)
    sheet.header(0, "joint state error", 1, above=0.14)
    sheet.header(2, "joint axis error", 3, above=0.14)
    for index, row in enumerate(rows):
        sheet.label(index, row.category.name, ruled=False)
        state_unit = ("°", 1.0) if any(row.category.turning) else (" cm", 100.0)
        for pair, errors, (unit, scale) in ((0, row.state, state_unit), (2, row.axis, ("°", 1.0))):
            hidden, cut = sheet.panel(index, pair), sheet.panel(index, pair + 1)
            for panel, by in ((hidden, by_hidden), (cut, by_share)):
                _draw_spreads(panel, {name: by(row, values * scale) for name, values in errors.items()}, unit)
            cut.set_xticks(SHARES[::2])
            if index == len(rows) - 1:
                hidden.set_xlabel("surface hidden in the view")
                cut.set_xlabel("pixels cut away")
    _legend(sheet, [name for name in METHOD_NAMES if any(name in row.axis for row in rows)])
    return sheet.figure


def _draw_spreads(panel: Axes, spreads: Mapping[str, Spread | None], unit: str) -> None:
    for method, spread in spreads.items():
        if spread is not None:
            (low, middle, high), colour = spread.quartiles.T, METHOD_COLOURS[method]
            panel.fill_between(spread.place, low, high, color=colour, alpha=0.16, linewidth=0)
            panel.plot(spread.place, middle, color=colour, linewidth=1.6, marker="o", markersize=2.8)
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
    sheet.figure.legend(
        lines, names, loc="lower center", bbox_to_anchor=(0.5, 0.2 / sheet.figure.get_figheight()), ncols=len(names),
        frameon=False, fontsize=8.5,
    )  # fmt: skip
    sheet.note("lines: medians over views · bands: from the lower to the upper quartile")
