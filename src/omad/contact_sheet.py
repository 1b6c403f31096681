"""A picture of many object models, at rest and with their joints moved, to see that they stand alike."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from matplotlib.figure import Figure

from .camera import STANDARD_CAMERA, Camera
from .objects import ObjectModel
from .render import render
from .report import shaded
from .viewpoints import look_at

AZIMUTH, ELEVATION = math.radians(35), math.radians(25)
COLUMNS = 6
MOST = 60
"""Models on one sheet."""


def contact_sheet(models: Sequence[ObjectModel]) -> Figure:
    """Every model from its front and a little from the right and above, at rest; below it, opened as far as it goes."""
    shown = models[:MOST]
    columns, rows = min(COLUMNS, len(shown)), -(-len(shown) // COLUMNS)
    fig = Figure(figsize=(2.6 * columns, 4.2 * rows), facecolor="white")
    panels = fig.subplots(2 * rows, columns, squeeze=False)
    for panel in panels.flat:
        panel.set_axis_off()
    for index, model in enumerate(shown):
        row, column = divmod(index, columns)
        far = np.abs(model.limits).argmax(1)
        opened = np.take_along_axis(model.limits, far[:, None], 1)[:, 0]
        for below, states in enumerate((np.zeros(len(opened)), opened)):
            panels[2 * row + below, column].imshow(picture(model, states))
        panels[2 * row, column].set_title(model.name, fontsize=8)
    left = f"; {len(models) - len(shown)} more are not shown" if len(models) > len(shown) else ""
    fig.suptitle(f"{models[0].category}: at rest, and opened{left}")
    fig.tight_layout(rect=(0, 0, 1, 0.98))
    return fig


def picture(
    model: ObjectModel, states: np.ndarray, azimuth: float = AZIMUTH, elevation: float = ELEVATION
) -> np.ndarray:
    """(H, W, 3) of the whole object; angles in radians, from its front and its horizon."""
    size = STANDARD_CAMERA.height // 2
    camera = Camera(size, size, 2.0 * size, 2.0 * size, (size - 1) / 2, (size - 1) / 2)
    vertices = np.concatenate(model.posed_vertices(states))
    centre = (vertices.min(0) + vertices.max(0)) / 2
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    T = np.eye(4)
    angles = [torch.tensor([angle], dtype=torch.float64) for angle in (azimuth, elevation, 0.0)]
    T[:3, :3] = look_at(*angles)[0].numpy()
    T[:3, 3] = (0, 0, 4.2 * radius) - T[:3, :3] @ centre
    return shaded(render(model, states, T, camera))
