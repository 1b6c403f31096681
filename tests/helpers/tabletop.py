"""A laptop on a table, as a depth camera sees it."""

from functools import cache

import numpy as np

from omad.data.procedural import generate
from omad.data.rendering.standard_views import View, standard_view
from omad.objects.category_file import get_category


@cache
def laptop_view() -> View:
    """One that shows both parts well: of a lid from its edge, a mask holds more of the background than of the lid."""
    category = get_category("laptop")
    return standard_view(generate(category, 0, "test"), category, (0, 1003))


def cloud_of(depth: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(depth)
    return np.stack([(columns - 319.5) / 600, (rows - 239.5) / 600, np.ones(len(rows))], 1) * depth[rows, columns, None]


@cache
def on_a_table() -> tuple[np.ndarray, np.ndarray]:
    """Depth (480, 640) of the laptop on a table, and where in it the laptop is."""
    view = laptop_view()
    up = view.T_camera_base[:3, 1]
    height = (cloud_of(view.depth) @ up).min() - 0.002
    rows, columns = np.indices(view.depth.shape)
    rays = np.stack([(columns - 319.5) / 600, (rows - 239.5) / 600, np.ones(view.depth.shape)], -1)
    table = height / (rays @ up)
    table = np.where((table > 0) & (table < 3), table, 0)
    return np.where(view.depth > 0, view.depth, table), np.asarray(view.depth > 0)
