"""A picture of many object models, at rest and with their joints moved, to see that they stand alike."""

import math
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from omad.data.rendering.rasteriser import render
from omad.data.rendering.viewpoints import pose_before
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.rigid import bounding_sphere
from omad.objects.model import ObjectModel

from .picture import blank_panels, lay_out, shaded

AZIMUTH, ELEVATION = math.radians(35), math.radians(25)
COLUMNS, LETTERS = 6, 26
"""Models in a row; letters of the title above each."""
MOST = 60
"""Models on one sheet."""


def contact_sheet(models: Sequence[ObjectModel]) -> Figure:
    """Every model from its front and a little from the right and above, at rest; below it, moved as far as it goes."""
    shown = models[:MOST]
    columns, rows = min(COLUMNS, len(shown)), -(-len(shown) // COLUMNS)
    fig, panels = blank_panels(2 * rows, columns, (2.6 * columns, 4.2 * rows))
    for index, model in enumerate(shown):
        row, column = divmod(index, columns)
        moved = model.limits[np.arange(len(model.limits)), np.abs(model.limits).argmax(1)]
        for below, states in enumerate((np.zeros(len(moved)), moved)):
            panels[2 * row + below, column].imshow(picture(model, states))
        panels[2 * row, column].set_title(model.name, fontsize=8)
    left = f"; {len(models) - len(shown)} more are not shown" if len(models) > len(shown) else ""
    title = textwrap.wrap(f"{models[0].category}: at rest; below, joints as far as they go{left}", LETTERS * columns)
    fig.suptitle("\n".join(title))
    lay_out(fig, (0, 0, 1, 1 - 0.05 * len(title) / rows))
    return fig


def picture(
    model: ObjectModel, states: np.ndarray, azimuth: float = AZIMUTH, elevation: float = ELEVATION
) -> np.ndarray:
    """(H, W, 3) of the whole object; angles in radians, from its front and its horizon."""
    size = STANDARD_CAMERA.height // 2
    camera = Camera(size, size, 2.0 * size, 2.0 * size, (size - 1) / 2, (size - 1) / 2)
    centre, radius = bounding_sphere(np.concatenate(model.posed_vertices(states)))
    return shaded(render(model, states, pose_before(4.2 * radius, azimuth, elevation, centre), camera))
