"""Random chests of drawers: with and without legs, overhanging tops, inset or overlaid fronts, trays, pulls."""

from itertools import pairwise

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, sides, slab
from ..vocabulary.handles import Pull
from ..vocabulary.stands import stand
from ..vocabulary.trays import tray


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One chest, all of its drawers closed, which are as many as the category's joints, the highest first. Body on
    y = 0 .. height, its front plane at z = 0, the room at +z."""
    count = len(category.joints)
    size = (count + 3) / 6
    width = rng.uniform(0.28, 0.85)
    height = rng.uniform(0.3 * size, 0.9 * size)
    depth = rng.uniform(0.26, 0.55)
    wall = rng.uniform(0.01, 0.035)
    base = rng.choice([0.0, rng.uniform(0.02, 0.1), rng.uniform(0.05, 0.25) * height])
    if count == 1:
        base = _as_table(rng.spawn(1)[0], height, base)
    thickness = rng.uniform(0.012, 0.035)
    inset = rng.random() < 0.45
    front = rng.uniform(0.0, 0.005) if inset else thickness  # plane of the drawers' faces

    low, high = base + wall, height - wall
    shares = rng.uniform(0.6, 1.4, count) if rng.random() < 0.6 else np.ones(count)
    edges = high - (high - low) * np.concatenate([[0.0], np.cumsum(shares / shares.sum())])
    if unusual and count > 1 and unusual.random() < 0.6:
        edges = _uneven(unusual, edges)
    whole = bool(unusual) and not inset and unusual.random() < 0.5  # fronts that leave nothing of the body to be seen
    cabinet = _cabinet(rng, width, height, depth, wall, base, edges, whole)
    pull = Pull(rng, unusual)
    fill = rng.uniform(0.4, 0.9) if rng.random() < 0.2 else 1.0  # trays leave their bays open above
    drawers = []
    for number, (top, bottom) in enumerate(pairwise(edges)):
        gap = rng.uniform(0.001, 0.004)
        half = width / 2 - wall - gap if inset else width / 2 - rng.uniform(0.0, 0.004)
        spill = -gap if inset or whole else wall * 0.45 - gap
        below, above = wall * whole * (number == count - 1), wall * whole * (number == 0)
        top = bottom + fill * (top - bottom)
        face_low, face_high = bottom - spill - below, top + spill + above
        solids = [slab((-half, face_low, front - thickness), (half, face_high, front), 2, 0.002, pull.bevel)]
        solids += tray(rng, width / 2 - wall - 0.012, bottom, top, depth, wall, front - thickness)
        solids += pull.solids(half, face_low, face_high, front)
        drawers.append(merge_meshes(solids))
    limits = np.tile([0.0, 0.6 * depth], (count, 1))
    return JointedParts((merge_meshes(cabinet), *drawers), np.zeros((count, 3)), limits=limits)


def _as_table(rng: np.random.Generator, height: float, base: float) -> float:
    """Where the body begins of what is rather a table with a drawer; or ``base``."""
    return height * rng.uniform(0.25, 0.7) if rng.random() < 0.6 else base


def _uneven(rng: np.random.Generator, edges: np.ndarray) -> np.ndarray:
    """Some drawers above lower than those below, as most makers have them."""
    count = len(edges) - 1
    heights = -np.diff(edges) * np.where(np.arange(count) < rng.integers(1, count), 1.0, rng.uniform(1.4, 2.3))
    return edges[0] + (edges[-1] - edges[0]) * np.concatenate([[0.0], np.cumsum(heights / heights.sum())])


def _cabinet(rng, width, height, depth, wall, base, edges, flush) -> list[Mesh]:
    """Walls, back, bottom, top, rails between the drawers, and what it stands on; the top is ``flush`` or juts out."""
    x, inner = width / 2, width / 2 - wall
    over, side = rng.choice([0.0, rng.uniform(0.005, 0.04)]), rng.choice([0.0, rng.uniform(0.005, 0.03)])
    over = 0.0 if flush else over
    bottomless = rng.random() < 0.15  # two sides that stand on the floor, nothing below the last drawer
    foot = 0.0 if bottomless else base
    solids = [
        *sides((-x, foot, -depth), (x, height, 0), wall),
        box((-inner, foot, -depth), (inner, height, -depth + wall * rng.uniform(0.3, 1.0))),
        slab((-x - side, height - wall, -depth), (x + side, height + rng.uniform(0.0, 0.02), over), 1, 0.004),
    ]
    if rng.random() < 0.5:
        solids += [box((-inner, y - 0.3 * wall, -depth * 0.9), (inner, y + 0.3 * wall, -0.002)) for y in edges[1:-1]]
    if bottomless:
        return solids
    solids.append(box((-inner, base, -depth + wall), (inner, base + wall, 0)))
    return solids + (stand(rng, x, depth, base) if base > 0.015 else [])
