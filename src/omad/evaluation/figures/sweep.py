"""What the model can do: one estimated object through its joints' travel, and the shapes that beta spans."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omad.common.arrays import as_doubles
from omad.data.rendering.standard_views import View
from omad.estimation.estimate import Estimate
from omad.geometry.mesh import Mesh, convex_hull
from omad.geometry.rigid import carry_each
from omad.model.prior import OmadPrior
from omad.model.surfaces.surfaces import Surfaces
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.output.picture import draw_points, part_colours

from .correspondence import opened
from .scene import arrows, caption, crop_around, draw_arrows, draw_keypoints, open_panel, paint, studio
from .style import ESTIMATED, FAINT, Sheet, styled

ASPECT = 0.9
SIGMAS = 2.0
FINER = 8
"""Steps of a keypoint's path between two joint states that are drawn."""


@dataclass(frozen=True)
class JointSweep:
    """One estimated object at S joint states."""

    category: Category
    view: View
    estimate: Estimate
    states: np.ndarray
    """(S, J), from the limits nearer to rest to the others; all joints together."""
    keypoints: np.ndarray
    """(S, M, 3) camera frame: W at these states."""
    paths: np.ndarray
    """((S - 1) FINER + 1, M, 3) camera frame: the same on the way from each state to the next."""


def joint_sweep(view: View, estimate: Estimate, steps: int) -> JointSweep:
    """Carry an estimate through its joints' travel."""
    category, model = estimate.category, estimate.object_model()
    states = np.stack([opened(model.limits, share) for share in np.linspace(0, 1, (steps - 1) * FINER + 1)])
    part_of = list(category.part_of_keypoint)
    transforms = (model.part_transforms(each, estimate.T_camera_base)[part_of] for each in states)
    paths = np.stack([carry_each(T, estimate.canonical_keypoints) for T in transforms])
    return JointSweep(category, view, estimate, states[::FINER], paths[::FINER], paths)


def record_joints(row: JointSweep) -> dict[str, Any]:
    """The numbers behind a row of the joint sweep."""
    return {
        "category": row.category.name,
        "object": row.view.object,
        "estimated_joint_states": row.estimate.joint_states.tolist(),
        "joint_states": row.states.tolist(),
        "keypoints": row.keypoints.tolist(),
    }


@styled
def draw_joints(rows: Sequence[JointSweep]) -> Figure:
    """A row a category: what was seen, then the estimated object from one end of its travel to the other."""
    steps = len(rows[0].states)
    sheet = Sheet.of(len(rows), steps + 1, ASPECT)
    sheet.header(0, "observed")
    sheet.header(1, "the estimated object through its joints' travel", steps)
    for index, row in enumerate(rows):
        sheet.label(index, row.category.name)
        _draw_joint_row(row, [sheet.panel(index, column) for column in range(steps + 1)])
    sheet.note("lines: where the keypoints go · arrows: joint axes")
    return sheet.figure


def _draw_joint_row(row: JointSweep, panels: Sequence[Axes]) -> None:
    estimate, model, pose = row.estimate, row.estimate.object_model(), row.estimate.pose()
    points = row.view.observation().points
    crop = crop_around(row.view.camera, np.concatenate([points, row.keypoints.reshape(-1, 3)]), ASPECT, foot=0.1)
    open_panel(panels[0], crop)
    draw_points(panels[0], crop, points, part_colours(estimate.part_labels), size=0.9)
    caption(panels[0], _travel(row, estimate.joint_states))
    for step, panel in enumerate(panels[1:]):
        paint(panel, crop, model.posed(row.states[step], estimate.T_camera_base), pale=0.35)
        for keypoint in row.paths[: FINER * step + 1].transpose(1, 0, 2):
            panel.plot(*crop.project(keypoint).T, color=FAINT, linewidth=0.6, zorder=2)
        draw_keypoints(panel, crop, row.keypoints[step], size=9)
        draw_arrows(panel, crop, arrows(row.category, pose.axes, pose.pivots, row.keypoints[step]), ESTIMATED)
        caption(panel, _travel(row, row.states[step]))


def _travel(row: JointSweep, states: np.ndarray) -> str:
    """Joint states, rounded."""
    each = zip(states, row.category.turning, strict=True)
    shown = [f"{np.degrees(state):.0f}°" if turns else f"{100 * state:.0f} cm" for state, turns in each]
    return ", ".join(dict.fromkeys(shown)).replace("-", "−")


@dataclass(frozen=True)
class ShapeSweep:
    """Shapes along the directions of beta that move the keypoints most; metres."""

    category: Category
    share: np.ndarray
    """(C,) of the keypoints' variance over training objects that lies along each direction."""
    beta: np.ndarray
    """(1 + 2 C, D): the mean, then minus and plus two standard deviations of each direction."""
    keypoints: np.ndarray
    """(1 + 2 C, M, 3)."""
    parts: tuple[tuple[Mesh, ...], ...]
    """Of each shape its parts' surfaces, canonical space at rest."""
    axes: np.ndarray
    """(1 + 2 C, J, 3)."""
    pivots: np.ndarray
    """(1 + 2 C, J, 3)."""


@torch.no_grad()
def shape_sweep(prior: OmadPrior, category: Category, directions: int, surfaces: Surfaces | None = None) -> ShapeSweep:
    """Principal directions of the keypoints ``B beta`` under the prior's Gaussian of beta."""
    mean, covariance = prior.beta_mean.double(), prior.beta_covariance.double()
    factor = torch.linalg.cholesky(covariance + 1e-9 * torch.eye(len(mean), dtype=torch.float64))
    _, singular, rows = torch.linalg.svd(prior.basis.double().flatten(0, 1) @ factor, full_matrices=False)
    moves = (factor @ rows[:directions].mT).mT  # (C, D): one standard deviation each
    signs = torch.tensor([-SIGMAS, SIGMAS], dtype=torch.float64)
    beta = torch.cat([mean[None], (mean + signs[:, None] * moves[:, None]).flatten(0, 1)])
    single = beta.to(prior.basis.dtype)
    joints, unit = prior.joints(single), category.metres_per_unit
    keypoints, part_of = as_doubles(prior.keypoints(single)) * unit, np.array(category.part_of_keypoint)
    if surfaces is None:
        parts = [tuple(convex_hull(each[part_of == k]) for k in range(len(category.parts))) for each in keypoints]
    else:
        parts = surfaces.of_beta(beta.numpy())
    return ShapeSweep(
        category=category,
        share=(singular.square() / singular.square().sum())[:directions].numpy(),
        beta=beta.numpy(),
        keypoints=keypoints,
        parts=tuple(parts),
        axes=as_doubles(joints.axes),
        pivots=as_doubles(joints.pivots) * unit,
    )


def record_shapes(row: ShapeSweep) -> dict[str, Any]:
    """The numbers behind a row of the shape sweep."""
    return {
        "category": row.category.name,
        "sigmas": SIGMAS,
        "variance_share": row.share.tolist(),
        "beta": row.beta.tolist(),
        "keypoints": row.keypoints.tolist(),
    }


@styled
def draw_shapes(rows: Sequence[ShapeSweep]) -> Figure:
    """A row a category: the mean shape, and both ends of each direction of beta."""
    count = len(rows[0].keypoints)
    sheet = Sheet.of(len(rows), count, ASPECT, top=0.46)
    sheet.header(0, "mean")
    for first in range(1, count, 2):
        sheet.header(first, f"direction {first // 2 + 1}", first + 1, above=0.24)
        sheet.header(first, f"−{SIGMAS:.0f} σ")
        sheet.header(first + 1, f"+{SIGMAS:.0f} σ")
    for index, row in enumerate(rows):
        sheet.label(index, row.category.name)
        _draw_shape_row(row, [sheet.panel(index, column) for column in range(count)])
    sheet.note("surfaces: of known objects with near keypoints · percent: share of the keypoints' variance")
    return sheet.figure


def _draw_shape_row(row: ShapeSweep, panels: Sequence[Axes]) -> None:
    category, part_of = row.category, np.array(row.category.part_of_keypoint)
    states, objects = opened(category.metric_limits), []
    for parts, axes, pivots in zip(row.parts, row.axes, row.pivots, strict=True):
        objects.append(ObjectModel.of(category, category.name, parts, axes, pivots))
    vertices = np.concatenate([vertices for model in objects for vertices in model.posed_vertices(states)])
    T, crop = studio(vertices, ASPECT, foot=0.08)  # one scale for all, so that sizes compare
    for index, (model, panel) in enumerate(zip(objects, panels, strict=True)):
        paint(panel, crop, model.posed(states, T), pale=0.3)
        T_keypoint = model.part_transforms(states, T)[part_of]
        draw_keypoints(panel, crop, carry_each(T_keypoint, row.keypoints[index]), size=9)
        if index % 2:
            caption(panel, f"{row.share[index // 2]:.0%}")
