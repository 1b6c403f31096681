"""Unseen objects: what the camera saw, what OMAD makes of it before and after refinement, and the truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omad.data.rendering.standard_views import true_pose
from omad.estimation.estimate import Estimate
from omad.geometry.camera import Camera
from omad.geometry.rigid import carry_each
from omad.model.object_prior import object_prior, relabelled
from omad.model.priornet import PriorNet
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.output.picture import draw_points, part_colours
from omad.sensing.observation import Observation

from ..evaluate import ViewResult
from ..metrics import PoseErrors
from .scene import GREY, arrows, caption, crop_around, draw_arrows, draw_keypoints, open_panel, paint
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
    estimate, keypoints = result.estimate, None
    if model is not None and priornet is not None:
        pose = true_pose(result.view, category)
        labellings = [(model, pose.T_camera_part)]
        if category.swap_symmetry:
            labellings.append((relabelled(model), pose.swapped().T_camera_part))
        part_of = list(category.part_of_keypoint)
        found = [carry_each(T[part_of], object_prior(priornet, [m]).keypoints[0]) for m, T in labellings]
        keypoints = min(found, key=lambda each: float(np.linalg.norm(each - estimate.keypoints, axis=1).mean()))
    return Shown(category, result, estimate, model, keypoints)


def record(row: Shown) -> dict[str, Any]:
    """The numbers behind one row."""
    view, estimate, keypoints = row.result.view, row.estimate, row.true_keypoints
    return {
        "category": row.category.name,
        "object": view.object,
        "seed": list(view.seed),
        "joint_states": {
            "initial": [joint.state for joint in estimate.initial.joints],
            "refined": estimate.joint_states.tolist(),
            "true": view.states.tolist(),
        },
        "errors": {"initial": _errors(row.result.initial), "refined": _errors(row.result.refined)},
        "keypoints": {
            "initial": estimate.initial.keypoints.tolist(),
            "refined": estimate.keypoints.tolist(),
            "true": None if keypoints is None else keypoints.tolist(),
        },
    }


def _errors(errors: PoseErrors) -> dict[str, Any]:
    return {
        "joint_state": errors.joint_state.tolist(),
        "axis_deg": np.degrees(errors.axis).tolist(),
        "rotation_deg": np.degrees(errors.rotation).tolist(),
    }


@styled
def draw(rows: Sequence[Shown], labels: Sequence[str]) -> Figure:
    """A row a view; ``labels`` stand at the left, equal ones that follow each other once."""
    sheet = Sheet.of(len(rows), len(COLUMNS), ASPECT)
    for column, name in enumerate(COLUMNS):
        sheet.header(column, name)
    for index, row in enumerate(rows):
        sheet.label(index, labels[index])
        _draw_row(row, [sheet.panel(index, column) for column in range(len(COLUMNS))])
    sheet.note("one colour is one keypoint on every object · arrows: estimated joint axes · dotted: true ones")
    return sheet.figure


def _draw_row(row: Shown, panels: Sequence[Axes]) -> None:
    view, estimate, category = row.result.view, row.estimate, row.category
    observation, truth = view.observation(), true_pose(view, category)
    reference = estimate.keypoints if row.true_keypoints is None else row.true_keypoints
    true_axes = arrows(category, truth.axes, truth.pivots, reference)
    stages = (
        (panels[2], estimate.initial.keypoints, estimate.initial_pose(), row.result.initial),
        (panels[3], estimate.keypoints, estimate.pose(), row.result.refined),
    )
    # all that the panels have to show; wild initial answers may be cut off
    vertices = [] if row.model is None else row.model.posed_vertices(view.states, view.T_camera_base)
    everything = [observation.points, estimate.keypoints, reference, true_axes.reshape(-1, 3), *vertices]
    crop = crop_around(view.camera, np.concatenate(everything), ASPECT, foot=0.1)

    draw_depth(panels[0], crop, observation)
    draw_points(panels[1], crop, observation.points, part_colours(estimate.part_labels))
    open_panel(panels[1], crop)
    for panel, keypoints, pose, errors in stages:
        _backdrop(panel, crop, row, observation, pale=0.35, grey=True)
        draw_keypoints(panel, crop, keypoints)
        draw_arrows(panel, crop, arrows(category, pose.axes, pose.pivots, keypoints), ESTIMATED)
        draw_arrows(panel, crop, true_axes, TRUE, dotted=True)
        caption(panel, error_text(errors, category))
    _backdrop(panels[4], crop, row, observation, pale=0.25)
    if row.true_keypoints is not None:
        draw_keypoints(panels[4], crop, row.true_keypoints)
    draw_arrows(panels[4], crop, true_axes, TRUE, dotted=True)


def draw_depth(panel: Axes, crop: Camera, observation: Observation) -> None:
    camera, depth, mask = observation.camera, observation.depth, observation.mask
    assert camera is not None
    assert depth is not None
    assert mask is not None
    scale = crop.fx / camera.fx
    left, top = crop.cx - (camera.cx + 0.5) * scale, crop.cy - (camera.cy + 0.5) * scale
    near, far = observation.depth_range
    extent = (left, left + camera.width * scale, top + camera.height * scale, top)
    depth = np.where(mask, depth, np.nan)
    panel.imshow(depth, cmap="viridis_r", vmin=near, vmax=far + 1e-6, extent=extent, interpolation="nearest")
    open_panel(panel, crop)


def _backdrop(panel: Axes, crop: Camera, row: Shown, seen: Observation, pale: float, grey: bool = False) -> None:
    """The true object where it is known, else the cloud."""
    view = row.result.view
    if row.model is None:
        draw_points(panel, crop, seen.points, GREY)
        open_panel(panel, crop)
    else:
        paint(panel, crop, row.model.posed(view.states, view.T_camera_base), pale, grey)


def error_text(errors: PoseErrors, category: Category) -> str:
    """Mean error over joints as a person reads it; lengths in centimetres."""
    turns = np.array(category.turning)
    words = []
    if turns.any():
        words.append(f"state {np.degrees(errors.joint_state[turns].mean()):.1f}°")
    if not turns.all():
        words.append(f"state {100 * errors.joint_state[~turns].mean():.1f} cm")
    return ", ".join([*words, f"axis {np.degrees(errors.axis.mean()):.1f}°"]) + " off"
