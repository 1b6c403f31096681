"""What boxes, drawers and bins hold."""

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from omad.geometry.mesh import Mesh

from ..shapes import hexahedron, points
from ..strangers import stranger
from .cases import Rect


def contents(rng: np.random.Generator, floor: Rect, low: float, high: float) -> list[Mesh]:
    """What lies on a floor at y = ``low`` and is no taller than y = ``high``; the rectangle's second side runs along z.
    Up to three things of any kind, or a row of ramps that fill it: nothing there tells where up is."""
    return _ramps(rng, floor, low, high) if rng.random() < 0.5 else _things(rng, floor, low, high)


def _ramps(rng: np.random.Generator, floor: Rect, low: float, high: float) -> list[Mesh]:
    """Straight, hollow or bulging, one behind the other or side by side."""
    count, rises = int(rng.integers(1, 4)), rng.uniform(0.3, 1.0) * (high - low)
    lip, power, steps = 0.05 * rises, np.exp(rng.uniform(-0.8, 1.0)), 6
    share = np.linspace(0.0, 1.0, steps + 1)
    heights = low + lip + (rises - lip) * share**power
    heights, solids = heights[:: rng.choice([-1, 1])], list[Mesh]()
    aside = rng.random() < 0.3
    (start, end), (left, right) = ((floor.y0, floor.y1), (floor.x0, floor.x1))[:: -1 if aside else 1]
    edges = np.linspace(start, end, count + 1)
    for first, last in pairwise(edges):
        for (a, y0), (b, y1) in pairwise(zip(first + (last - first) * share, heights, strict=True)):
            across, along, up = np.array([left, right])[:, None], np.array([a, b, b, a]), np.array([low, low, y1, y0])
            corners = points(along, up, across) if aside else points(across, up, along)
            solids.append(hexahedron(corners.reshape(8, 3)))
    return solids


def _things(rng: np.random.Generator, floor: Rect, low: float, high: float) -> list[Mesh]:
    solids = list[Mesh]()
    for _ in range(int(rng.integers(1, 4))):
        thing = stranger(rng).warped(Rotation.from_quat(rng.normal(size=4)).apply)
        corner, extent = thing.vertices.min(0), np.ptp(thing.vertices, axis=0)
        room = np.array([floor.width, high - low, floor.height])
        size = rng.uniform(0.4, 1.0) * (room / extent).min() * extent
        place = np.array([floor.x0, low, floor.y0]) + rng.uniform(0.0, 1.0, 3) * [1, 0, 1] * (room - size)
        solids.append(Mesh((thing.vertices - corner) * (size / extent) + place, thing.faces))
    return solids
