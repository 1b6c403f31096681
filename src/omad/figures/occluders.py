"""How much of an object a view hides, and how to hide more of it."""

from __future__ import annotations

import numpy as np

from ..objects import ObjectModel
from ..render import render
from ..standard_views import View

SURFACE_POINTS = 4000
DEPTH_SLACK = 0.01
"""Of the object's diagonal: a surface point this near to the depth image is seen."""


def hidden_share(view: View, model: ObjectModel) -> float:
    """Share of the object's surface, both sides and inner walls included, that the view does not show."""
    surface = model.surface_samples(SURFACE_POINTS, np.random.default_rng(0))
    T = model.part_transforms(view.states, view.T_camera_base)[surface.labels]
    points = (T[:, :3, :3] @ surface.points[..., None].astype(np.float64))[..., 0] + T[:, :3, 3]
    camera = view.camera
    depth = render(model, view.states, view.T_camera_base, camera).depth
    columns = np.rint(points[:, 0] / points[:, 2] * camera.fx + camera.cx).astype(int)
    rows = np.rint(points[:, 1] / points[:, 2] * camera.fy + camera.cy).astype(int)
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    nearest = depth[np.where(inside, rows, 0), np.where(inside, columns, 0)]
    seen = inside & (nearest > 0) & (np.abs(points[:, 2] - nearest) < DEPTH_SLACK * view.truth.diagonal)
    return 1 - float(seen.mean())


def occlude(depth: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """``depth`` (H, W) without ``share`` of its measured pixels: those on one side of a random line, or those in a
    random box around one of them."""
    rows, columns = np.nonzero(depth)
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
