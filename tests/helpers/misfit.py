"""Proof of a reader's geometry: an object's surface points, carried by a view's truth, lie where its image is."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import KDTree

from omad.data.rendering.standard_views import View
from omad.geometry.kinematics import part_transforms
from omad.geometry.rigid import carry
from omad.objects.category import Category
from omad.objects.model import PointObject

FITS = 0.02
"""A part whose misfit is below this lies where the image shows it."""
PIXELS = 2000
"""Of a part, that are looked at."""


def misfit(view: View, surface: PointObject, category: Category) -> np.ndarray:
    """(K,) how far the depth pixels of each part lie from its carried points: median, as a share of the object's box
    diagonal; NaN for a part that the image does not show."""
    truth, camera = view.truth, view.camera
    arrays = [torch.as_tensor(a)[None] for a in (truth.axes, truth.pivots, view.states, view.T_camera_base)]
    transforms = part_transforms(category.metric_tree, *arrays)[0].numpy()
    result = np.full(len(transforms), np.nan)
    for part, T in enumerate(transforms):
        rows, columns = np.nonzero(view.labels == part)
        if not len(rows):
            continue
        some = np.linspace(0, len(rows) - 1, min(PIXELS, len(rows))).astype(int)
        rows, columns = rows[some], columns[some]
        z = view.depth[rows, columns].astype(np.float64)
        cloud = camera.backproject(np.stack([columns, rows], 1), z)
        points = carry(T, surface.surface.points[surface.surface.labels == part])
        result[part] = np.median(KDTree(points).query(cloud)[0]) / truth.diagonal
    return result
