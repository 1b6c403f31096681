"""Unseen objects: what the camera saw, what OMAD makes of it before and after refinement, and the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..categories import Category
from ..estimate import Estimate
from ..evaluation import ViewResult, true_pose
from ..metrics import ObjectPose, PoseErrors
from ..object_prior import object_prior, placed, relabelled
from ..objects import ObjectModel
from ..observation import Observation
from ..priornet import PriorNet
from ..report import PART_COLOURS
from .scene import GREY, Arrow, Window, arrows, caption, draw_arrows, draw_cloud, draw_keypoints, paint
from .style import ESTIMATED, TRUE, Sheet, styled

ASPECT = 0.82
COLUMNS = ("depth image", "parts found", "initial", "refined", "truth")


@dataclass(frozen=True)
class Shown:
    """One view, its estimate, and what is known of the truth."""

    category: Category
    result: ViewResult
    estimate: Estimate
    model: ObjectModel | None
    """None where the source has images only."""
    true_keypoints: np.ndarray | None
    """(M, 3) camera frame, labelled as the estimate labels its parts."""


def shown(
    result: ViewResult, category: Category, model: ObjectModel | None = None, priornet: PriorNet | None = None
) -> Shown | None:
    """What a row of the figure needs; None where the view could not be estimated."""
    if result.estimate is None:
        return None
    keypoints = None
    if model is not None and priornet is not None:
        keypoints = _true_keypoints(result, result.estimate, category, model, priornet)
    return Shown(category, result, result.estimate, model, keypoints)


def _true_keypoints(
    result: ViewResult, estimate: Estimate, category: Category, model: ObjectModel, priornet: PriorNet
) -> np.ndarray:
    pose = true_pose(result.view, category)
    labellings = [(model, pose)]
    if category.swap_symmetry:
        labellings.append((relabelled(model), pose.swapped()))
    found = [
        placed(object_prior(priornet, [thing]).keypoints[0], where.T_camera_part, category.part_of_keypoint)
        for thing, where in labellings
    ]
    return min(found, key=lambda keypoints: float(np.linalg.norm(keypoints - estimate.keypoints, axis=1).mean()))


def record(row: Shown) -> dict[str, Any]:
    """The numbers behind one row."""
    keypoints = row.true_keypoints
    return {
        "category": row.category.name,
        "object": row.result.view.object,
        "seed": list(row.result.view.seed),
        "joint_states": {
            "initial": [joint.state for joint in row.estimate.initial.joints],
            "refined": row.estimate.joint_states.tolist(),
            "true": row.result.view.states.tolist(),
        },
        "errors": {"initial": _errors(row.result.initial), "refined": _errors(row.result.refined)},
        "keypoints": {
            "initial": row.estimate.initial.keypoints.tolist(),
            "refined": row.estimate.keypoints.tolist(),
            "true": None if keypoints is None else keypoints.tolist(),
        },
    }


def _errors(errors: PoseErrors) -> dict[str, Any]:
    return {
        "joint_state": errors.joint_state.tolist(),
        "axis_deg": np.degrees(errors.axis).tolist(),
        "rotation_deg": np.degrees(errors.rotation).tolist(),
    }


def draw(rows: Sequence[Shown], labels: Sequence[str]) -> Figure:
    """A row a view; ``labels`` stand at the left, equal ones that follow each other once."""
    with styled():
        sheet = Sheet.of(len(rows), len(COLUMNS), ASPECT, bottom=0.26)
        for column, name in enumerate(COLUMNS):
            sheet.header(column, name)
        for index, row in enumerate(rows):
            sheet.label(index, labels[index])
            if index:
                sheet.rule(index)
            _draw_row(row, [sheet.panel(index, column) for column in range(len(COLUMNS))])
        sheet.note("one colour is one keypoint on every object · arrows: estimated joint axes · dotted: true ones")
        return sheet.figure


def _draw_row(row: Shown, panels: Sequence[Axes]) -> None:
    view, estimate, category = row.result.view, row.estimate, row.category
    observation = Observation.from_depth(view.depth, view.camera)
    reference = estimate.keypoints if row.true_keypoints is None else row.true_keypoints
    true_axes = _arrows(true_pose(view, category), reference, category)
    stages = (
        (panels[2], estimate.initial.keypoints, estimate.initial_pose(), row.result.initial),
        (panels[3], estimate.keypoints, estimate.pose(), row.result.refined),
    )
    window = Window.around(view.camera, _everything(row, observation, reference, true_axes), ASPECT, foot=0.1)

    _draw_depth(panels[0], window, observation)
    draw_cloud(panels[1], window, observation.points, PART_COLOURS[estimate.part_labels % len(PART_COLOURS)])
    window.open(panels[1])
    for panel, keypoints, pose, errors in stages:
        _backdrop(panel, window, row, observation, pale=0.35, grey=True)
        draw_keypoints(panel, window, keypoints)
        draw_arrows(panel, window, _arrows(pose, keypoints, category), ESTIMATED)
        draw_arrows(panel, window, true_axes, TRUE, dotted=True)
        caption(panel, error_text(errors, category))
    _backdrop(panels[4], window, row, observation, pale=0.25)
    if row.true_keypoints is not None:
        draw_keypoints(panels[4], window, row.true_keypoints)
    draw_arrows(panels[4], window, true_axes, TRUE, dotted=True)


def _everything(row: Shown, observation: Observation, keypoints: np.ndarray, true_axes: Sequence[Arrow]) -> np.ndarray:
    """Points (N, 3) of the camera frame that the panels of a row have to show; wild initial answers may be cut off."""
    view, ends = row.result.view, [end for arrow in true_axes for end in (arrow.tail, arrow.tip)]
    vertices = [] if row.model is None else row.model.posed_vertices(view.states, view.T_camera_base)
    return np.concatenate([observation.points, row.estimate.keypoints, keypoints, np.stack(ends), *vertices])


def _draw_depth(panel: Axes, window: Window, observation: Observation) -> None:
    window.open(panel)
    assert observation.depth is not None
    assert observation.mask is not None
    assert observation.camera is not None
    camera, crop = observation.camera, window.camera
    scale = crop.fx / camera.fx
    left, top = crop.cx - (camera.cx + 0.5) * scale, crop.cy - (camera.cy + 0.5) * scale
    depth = np.where(observation.mask, observation.depth, np.nan)
    near, far = np.percentile(observation.points[:, 2], [1, 99])
    extent = (left, left + camera.width * scale, top + camera.height * scale, top)
    panel.imshow(depth, cmap="viridis_r", vmin=near, vmax=far + 1e-6, extent=extent, interpolation="nearest")
    window.open(panel)


def _backdrop(
    panel: Axes, window: Window, row: Shown, observation: Observation, pale: float, grey: bool = False
) -> None:
    """The true object where it is known, else the cloud."""
    view = row.result.view
    if row.model is None:
        draw_cloud(panel, window, observation.points, GREY)
        window.open(panel)
        return
    colours = np.tile(GREY, (len(row.model.parts), 1)) if grey else None
    paint(panel, window, row.model, view.states, view.T_camera_base, colours, pale)


def _arrows(pose: ObjectPose, keypoints: np.ndarray, category: Category) -> list[Arrow]:
    pivots = np.where(np.array(category.revolute)[:, None], pose.pivots, np.nan)
    return arrows(pose.axes, pivots, keypoints, category.part_of_keypoint)


def error_text(errors: PoseErrors, category: Category) -> str:
    """Mean error over joints as a person reads it; lengths as percent of a category unit."""
    turns = np.array(category.revolute)
    words = []
    if turns.any():
        words.append(f"state {np.degrees(errors.joint_state[turns].mean()):.1f}°")
    if not turns.all():
        words.append(f"state {100 * errors.joint_state[~turns].mean():.1f} cm")
    return ", ".join([*words, f"axis {np.degrees(errors.axis.mean()):.1f}°"]) + " off"
