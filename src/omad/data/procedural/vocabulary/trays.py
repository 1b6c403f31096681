"""Drawers behind their faces."""

import numpy as np

from omad.geometry.mesh import Mesh

from ..shapes import box, sides


def tray(rng: np.random.Generator, half, bottom, top, depth, wall, back_of_face) -> list[Mesh]:
    """The drawer behind its face: two sides, bottom, back, open above."""
    deep, side = (depth - wall) * rng.uniform(0.78, 0.99), rng.uniform(0.006, 0.015)
    low, high = bottom + 0.25 * wall + 0.004, top - (top - bottom) * rng.uniform(0.08, 0.4)
    inner = half - side
    return [
        *sides((-half, low, -deep), (half, high, back_of_face), side),
        box((-inner, low, -deep), (inner, high, -deep + side)),
        box((-inner, low, -deep + side), (inner, low + side, back_of_face)),
    ]
