"""The prior's keypoints on many objects: one index is one place, whatever the object's shape."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omad.geometry.rigid import carry, carry_each, rotate_each
from omad.model.object_prior import ObjectPrior, object_prior
from omad.model.priornet import PriorNet
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from ..keypoint_spread import KeypointSpread, keypoint_spread
from .scene import arrows, caption, draw_arrows, draw_keypoints, open_panel, paint, studio
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


def opened(limits: np.ndarray, share: float = OPENED) -> np.ndarray:
    """(J,) joint states a ``share`` of the way from the limit (J, 2) nearer to rest to the other one."""
    near, far = np.take_along_axis(limits, np.abs(limits).argsort(axis=1, kind="stable"), 1).T
    return near + share * (far - near)


@styled
def draw(rows: Sequence[Correspondence], columns: int) -> Figure:
    """A row a category: ``columns`` objects, and at the right the keypoints of all in one frame."""
    sheet = Sheet.of(len(rows), columns + 1, ASPECT)
    sheet.header(0, "unseen objects", columns - 1)
    sheet.header(columns, "all in one frame")
    for index, row in enumerate(rows):
        sheet.label(index, row.category.name)
        for column in range(min(columns, len(row.models))):
            _draw_object(sheet.panel(index, column), row, column)
        _draw_together(sheet.panel(index, columns), row)
    sheet.note("one colour is one keypoint on every object · arrows: joint axes of the prior")
    return sheet.figure


def _draw_object(panel: Axes, row: Correspondence, number: int) -> None:
    model, prior = row.models[number], row.prior
    states = opened(model.limits)
    T, crop = studio(np.concatenate(model.posed_vertices(states)), ASPECT)
    paint(panel, crop, model.posed(states, T), pale=0.3, grey=True)
    transforms = model.part_transforms(states, T)
    moved = carry_each(transforms[list(row.category.part_of_keypoint)], prior.keypoints[number])
    draw_keypoints(panel, crop, moved, size=14)
    parents = transforms[list(model.tree.parents)]
    axes, pivots = rotate_each(parents, prior.axes[number]), carry_each(parents, prior.pivots[number])
    draw_arrows(panel, crop, arrows(row.category, axes, pivots, moved), ESTIMATED)


def _draw_together(panel: Axes, row: Correspondence) -> None:
    """Each object's box scaled to the mean one, so that only the places inside it differ."""
    boxes = np.stack([model.part_boxes() for model in row.models])
    low, high = boxes[:, :, 0].min(1), boxes[:, :, 1].max(1)
    size = (high - low).mean(0)
    points = (row.prior.keypoints - (low + high)[:, None] / 2) / (high - low)[:, None] * size
    T, crop = studio(points.reshape(-1, 3), ASPECT, foot=0.1)
    open_panel(panel, crop)
    wander = float(np.linalg.norm(points - points.mean(0), axis=-1).mean() / np.linalg.norm(size))
    colours = keypoint_colours(points.shape[1])
    for keypoint, colour in zip(points.transpose(1, 0, 2), colours, strict=True):
        panel.scatter(*crop.project(carry(T, keypoint)).T, s=5, color=colour, alpha=0.55, linewidths=0)
    caption(panel, f"{len(points)} objects, {wander:.1%} apart")
