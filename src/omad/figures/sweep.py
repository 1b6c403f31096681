"""What the model can do: one estimated object through its joints' travel, and the shapes that beta spans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..categories import Category
from ..estimate import Estimate, convex_hull
from ..object_prior import placed
from ..objects import ObjectModel
from ..observation import Observation
from ..prior import OmadPrior
from ..report import PART_COLOURS
from ..standard_views import View
from .correspondence import opened
from .scene import Window, arrows, caption, draw_arrows, draw_cloud, draw_keypoints, paint, studio
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
    shares = np.linspace(0, 1, (steps - 1) * FINER + 1)
    states = np.stack([opened(category, model.limits, share) for share in shares])
    paths = np.stack(
        [
            placed(
                estimate.canonical_keypoints,
                model.part_transforms(each, estimate.T_camera_base),
                category.part_of_keypoint,
            )
            for each in states
        ]
    )
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


def draw_joints(rows: Sequence[JointSweep]) -> Figure:
    """A row a category: what was seen, then the estimated object from one end of its travel to the other."""
    with styled():
        steps = len(rows[0].states)
        sheet = Sheet.of(len(rows), steps + 1, ASPECT, bottom=0.26)
        sheet.header(0, "observed")
        sheet.header(1, "the estimated object through its joints' travel", steps)
        for index, row in enumerate(rows):
            sheet.label(index, row.category.name)
            if index:
                sheet.rule(index)
            _draw_joint_row(row, [sheet.panel(index, column) for column in range(steps + 1)])
        sheet.note("parts: convex hulls of the keypoints · lines: where the keypoints go · arrows: joint axes")
        return sheet.figure


def _draw_joint_row(row: JointSweep, panels: Sequence[Axes]) -> None:
    estimate, model = row.estimate, row.estimate.object_model()
    observation = Observation.from_depth(row.view.depth, row.view.camera)
    everything = np.concatenate([observation.points, row.keypoints.reshape(-1, 3)])
    window = Window.around(row.view.camera, everything, ASPECT, foot=0.1)
    window.open(panels[0])
    labels = estimate.part_labels % len(PART_COLOURS)
    draw_cloud(panels[0], window, observation.points, PART_COLOURS[labels], size=0.9)
    caption(panels[0], _travel(row, estimate.joint_states))
    pose = estimate.pose()
    pivots = np.where(np.array(row.category.revolute)[:, None], pose.pivots, np.nan)
    for step, panel in enumerate(panels[1:]):
        paint(panel, window, model, row.states[step], estimate.T_camera_base, pale=0.35)
        for keypoint in row.paths[: FINER * step + 1].transpose(1, 0, 2):
            panel.plot(*window.project(keypoint).T, color=FAINT, linewidth=0.6, zorder=2)
        draw_keypoints(panel, window, row.keypoints[step], size=9)
        drawn = arrows(pose.axes, pivots, row.keypoints[step], row.category.part_of_keypoint)
        draw_arrows(panel, window, drawn, ESTIMATED)
        caption(panel, _travel(row, row.states[step]))


def _travel(row: JointSweep, states: np.ndarray) -> str:
    """Joint states, rounded."""
    shown = [
        f"{np.degrees(state):.0f}°" if turns else f"{100 * state:.0f} cm"
        for state, turns in zip(states, row.category.revolute, strict=True)
    ]
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
    axes: np.ndarray
    """(1 + 2 C, J, 3)."""
    pivots: np.ndarray
    """(1 + 2 C, J, 3), NaN for prismatic joints."""


@torch.no_grad()
def shape_sweep(prior: OmadPrior, category: Category, directions: int) -> ShapeSweep:
    """Principal directions of the keypoints ``B beta`` under the prior's Gaussian of beta."""
    mean, covariance = prior.beta_mean.double(), prior.beta_covariance.double()
    factor = torch.linalg.cholesky(covariance + 1e-9 * torch.eye(len(mean), dtype=torch.float64))
    _, singular, rows = torch.linalg.svd(prior.basis.double().flatten(0, 1) @ factor, full_matrices=False)
    moves = (factor @ rows[:directions].mT).mT  # (C, D): one standard deviation each
    signs = torch.tensor([-SIGMAS, SIGMAS], dtype=torch.float64)
    beta = torch.cat([mean[None], (mean + signs[:, None] * moves[:, None]).flatten(0, 1)])
    joints = prior.joints(beta.to(prior.basis.dtype))
    pivots = joints.pivots.cpu().double().numpy() * category.metres_per_unit
    return ShapeSweep(
        category=category,
        share=(singular.square() / singular.square().sum())[:directions].numpy(),
        beta=beta.numpy(),
        keypoints=prior.keypoints(beta.to(prior.basis.dtype)).cpu().double().numpy() * category.metres_per_unit,
        axes=joints.axes.cpu().double().numpy(),
        pivots=np.where(np.array(category.revolute)[:, None], pivots, np.nan),
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


def draw_shapes(rows: Sequence[ShapeSweep]) -> Figure:
    """A row a category: the mean shape, and both ends of each direction of beta."""
    with styled():
        count = len(rows[0].keypoints)
        sheet = Sheet.of(len(rows), count, ASPECT, bottom=0.26, top=0.46)
        sheet.header(0, "mean")
        for first in range(1, count, 2):
            sheet.header(first, f"direction {first // 2 + 1}", first + 1, above=0.24)
            sheet.header(first, f"−{SIGMAS:.0f} σ")
            sheet.header(first + 1, f"+{SIGMAS:.0f} σ")
        for index, row in enumerate(rows):
            sheet.label(index, row.category.name)
            if index:
                sheet.rule(index)
            _draw_shape_row(row, [sheet.panel(index, column) for column in range(count)])
        sheet.note("parts: convex hulls of the keypoints · percent: share of the keypoints' variance over objects")
        return sheet.figure


def _draw_shape_row(row: ShapeSweep, panels: Sequence[Axes]) -> None:
    category = row.category
    limits = np.array([joint.limits for joint in category.joints])
    limits[~np.array(category.revolute)] *= category.metres_per_unit
    states = opened(category, limits)
    objects = [_as_model(row, index, limits) for index in range(len(row.keypoints))]
    vertices = np.concatenate([np.concatenate(model.posed_vertices(states)) for model in objects])
    T, window = studio(vertices, ASPECT, foot=0.08)  # one scale for all, so that sizes compare
    for index, (model, panel) in enumerate(zip(objects, panels, strict=True)):
        paint(panel, window, model, states, T, pale=0.3)
        transforms = model.part_transforms(states, T)
        draw_keypoints(panel, window, placed(row.keypoints[index], transforms, category.part_of_keypoint), size=9)
        if index % 2:
            caption(panel, f"{row.share[index // 2]:.0%}")


def _as_model(row: ShapeSweep, index: int, limits: np.ndarray) -> ObjectModel:
    category = row.category
    part_of = np.array(category.part_of_keypoint)
    return ObjectModel(
        name=f"{category.name}-{index}",
        category=category.name,
        part_names=tuple(part.name for part in category.parts),
        parts=tuple(convex_hull(row.keypoints[index][part_of == k]) for k in range(len(category.parts))),
        joint_names=tuple(joint.name for joint in category.joints),
        tree=category.tree,
        axes=row.axes[index],
        pivots=np.nan_to_num(row.pivots[index]),
        limits=limits,
    )
