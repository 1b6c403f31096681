"""Proof of the geometry: an object's surface points, carried by a view's truth, must lie where its depth image is."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import KDTree

from ...categories import Category
from ...kinematics import part_transforms
from ...objects import PointObject
from ...standard_views import View

FITS = 0.02
"""A part whose misfit is below this lies where the image shows it."""
PIXELS = 2000
"""Of a part, that are looked at."""


def misfit(view: View, surface: PointObject, category: Category) -> np.ndarray:
    """(K,) how far the depth pixels of each part lie from its carried points: median, as a share of the object's box
    diagonal; NaN for a part that the image does not show."""
    truth, camera = view.truth, view.camera
    arrays = [torch.as_tensor(a)[None] for a in (truth.axes, truth.pivots, view.states, view.T_camera_base)]
    transforms = part_transforms(category.tree, *arrays)[0].numpy()
    result = np.full(len(transforms), np.nan)
    for part, T in enumerate(transforms):
        rows, columns = np.nonzero(view.labels == part)
        if not len(rows):
            continue
        some = np.linspace(0, len(rows) - 1, min(PIXELS, len(rows))).astype(int)
        rows, columns = rows[some], columns[some]
        z = view.depth[rows, columns].astype(np.float64)
        cloud = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], 1)
        points = surface.surface.points[surface.surface.labels == part] @ T[:3, :3].T + T[:3, 3]
        result[part] = np.median(KDTree(points).query(cloud)[0]) / truth.diagonal
    return result
