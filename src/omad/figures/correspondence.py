"""The prior's keypoints on many objects: one index is one place, whatever the object's shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..categories import Category
from ..keypoint_check import KeypointSpread, keypoint_spread
from ..object_prior import ObjectPrior, object_prior, placed
from ..objects import ObjectModel
from ..priornet import PriorNet
from .scene import GREY, arrows, caption, draw_arrows, draw_keypoints, paint, studio
from .style import ESTIMATED, Sheet, keypoint_colours, styled

ASPECT = 0.86
OPENED = 0.3
"""Share of their travel that joints are drawn opened by, so that no part hides another."""


@dataclass(frozen=True)
class Correspondence:
    """A category's prior on N unseen objects."""

    category: Category
    models: tuple[ObjectModel, ...]
    prior: ObjectPrior
    spread: KeypointSpread


def correspondence(net: PriorNet, models: Sequence[ObjectModel]) -> Correspondence:
    """Fit the prior to ``models``."""
    return Correspondence(net.category, tuple(models), object_prior(net, models), keypoint_spread(net, models))


def record(found: Correspondence) -> dict[str, Any]:
    """The numbers behind a row; canonical space, metres."""
    return {
        "category": found.category.name,
        "objects": [model.name for model in found.models],
        "keypoints": found.prior.keypoints.tolist(),
        "axes": found.prior.axes.tolist(),
        "pivots": found.prior.pivots.tolist(),
        "wander": found.spread.wander,
        "mean_wander": found.spread.mean_wander,
        "metres_per_unit": found.category.metres_per_unit,
    }


def opened(category: Category, limits: np.ndarray, share: float = OPENED) -> np.ndarray:
    """(J,) joint states a ``share`` of the way from the limit (J, 2) nearer to rest to the other one."""
    near_first = np.abs(limits[:, 0]) <= np.abs(limits[:, 1])
    near, far = np.where(near_first, limits[:, 0], limits[:, 1]), np.where(near_first, limits[:, 1], limits[:, 0])
    return near + share * (far - near)


def draw(rows: Sequence[Correspondence], columns: int) -> Figure:
    """A row a category: ``columns`` objects, and at the right the keypoints of all in one frame."""
    with styled():
        sheet = Sheet.of(len(rows), columns + 1, ASPECT, bottom=0.26)
        sheet.header(0, "unseen objects", columns - 1)
        sheet.header(columns, "all in one frame")
        for index, row in enumerate(rows):
            sheet.label(index, row.category.name)
            if index:
                sheet.rule(index)
            for column, model in enumerate(row.models[:columns]):
                _draw_object(sheet.panel(index, column), row, column, model)
            _draw_together(sheet.panel(index, columns), row)
        sheet.note("one colour is one keypoint on every object · arrows: joint axes of the prior")
        return sheet.figure


def _draw_object(panel: Axes, row: Correspondence, number: int, model: ObjectModel) -> None:
    states = opened(row.category, model.limits)
    keypoints, axes, pivots = row.prior.keypoints[number], row.prior.axes[number], row.prior.pivots[number]
    vertices = np.concatenate(model.posed_vertices(states))
    T, window = studio(vertices, ASPECT)
    paint(panel, window, model, states, T, np.tile(GREY, (len(model.parts), 1)), pale=0.3)
    transforms = model.part_transforms(states, T)
    moved = placed(keypoints, transforms, row.category.part_of_keypoint)
    draw_keypoints(panel, window, moved, size=14)
    parents = transforms[list(model.tree.parents)]
    axes = (parents[:, :3, :3] @ axes[..., None])[..., 0]
    pivots = (parents[:, :3, :3] @ pivots[..., None])[..., 0] + parents[:, :3, 3]
    draw_arrows(panel, window, arrows(axes, pivots, moved, row.category.part_of_keypoint), ESTIMATED)


def _draw_together(panel: Axes, row: Correspondence) -> None:
    """Each object's box scaled to the mean one, so that only the places inside it differ."""
    boxes = np.stack([model.part_boxes() for model in row.models])
    low, high = boxes[:, :, 0].min(1), boxes[:, :, 1].max(1)
    size = (high - low).mean(0)
    points = (row.prior.keypoints - (low + high)[:, None] / 2) / (high - low)[:, None] * size
    T, window = studio(points.reshape(-1, 3), ASPECT, foot=0.1)
    window.open(panel)
    wander = float(np.linalg.norm(points - points.mean(0), axis=-1).mean() / np.linalg.norm(size))
    colours = keypoint_colours(points.shape[1])
    for keypoint, colour in zip(points.transpose(1, 0, 2), colours, strict=True):
        uv = window.project(keypoint @ T[:3, :3].T + T[:3, 3])
        panel.scatter(*uv.T, s=5, color=colour, alpha=0.55, linewidths=0)
    caption(panel, f"{len(points)} objects, {wander:.1%} apart")
