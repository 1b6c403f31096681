"""Random boxes with a hinged lid: of wood, cardboard, plastic or metal, from jewellery's to a chest."""

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder, loft, points
from ..vocabulary.cases import Rect
from ..vocabulary.contents import contents
from ..vocabulary.handles import handle
from ..vocabulary.stands import feet
from ..vocabulary.vessels import Lid, Outline, lid


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One box, shut, hinged at the back. Body on y = 0 .. rim, its middle at x = z = 0. Unusual ones have no sharp
    edge, and may be full of things."""
    width = rng.uniform(0.3, 0.5)
    depth, rim = width * rng.uniform(0.5, 1.0), width * rng.uniform(0.15, 0.6)
    wall = min(rng.choice([rng.uniform(0.001, 0.004), rng.uniform(0.004, 0.018)]), 0.06 * width)
    tall = rim * rng.choice([rng.uniform(0.06, 0.25), rng.uniform(0.2, 0.6)])
    outline = Outline(width, depth, rng.choice([0.0, rng.uniform(0.0, 0.4)]))
    if unusual:
        outline = Outline(width, depth, unusual.uniform(0.05, 0.4), width * unusual.uniform(0.02, 0.12))
    flare = rng.uniform(0.85, 1.0) if rng.random() < 0.25 else 1.0
    floor = max(wall * rng.uniform(0.8, 2.0), 0.002)
    if rng.random() < 0.4:  # a tray, padding, or what it is full of, below where a lid's lip comes
        floor = max(floor, min(rim * rng.uniform(0.1, 0.8), rim - 0.4 * tall - 0.004))
    body = [outline.shell(0.0, rim, wall, floor, flare)]
    foot = Rect(-width * flare / 2, width * flare / 2, -depth * flare / 2, depth * flare / 2).grown(-outline.fillet)
    level = foot.grown(-wall)
    if rng.random() < 0.3:
        high = floor + (rim - floor) * rng.uniform(0.4, 0.95)
        body += _dividers(rng, level, floor, high, 0.6 * wall)
    if unusual and unusual.random() < 0.8:
        below = max(rim - 0.4 * tall - 0.004, 0.5 * (floor + rim))
        body += contents(unusual, level, floor - 1e-4, below)
    body += feet(rng, foot.x1, foot.height, 0.06 * rim, foot.y1)

    top = _barrel(rng, width, depth, rim, tall) if rng.random() < 0.12 else lid(rng, outline, rim, wall, tall)
    moving = list(top.solids)
    if rng.random() < 0.5:  # a catch, on either
        half, front = width * rng.uniform(0.02, 0.1), depth / 2
        low, high = rim - rng.uniform(0.05, 0.3) * rim, rim - 0.002
        body.append(box((-half, low, front - 0.002), (half, high, front + rng.uniform(0.002, 0.01))))
    if rng.random() < 0.35 and top.top - top.hinge > 0.03:
        moving += handle(rng, Rect(-width / 2, width / 2, top.hinge, top.top), depth / 2 + top.behind, "top", 0.2)
    radius = rng.uniform(0.002, 0.008)
    pivot = np.array([0.0, top.hinge, -depth / 2 - top.behind - rng.choice([0.0, rng.uniform(0.0, 1.5)]) * radius])
    if rng.random() < 0.5:
        for x in (-0.3, 0.3) if rng.random() < 0.7 else (0.0,):
            half = rng.uniform(0.03, 0.12) * width
            barrel = cylinder((x * width - half, *pivot[1:]), (x * width + half, *pivot[1:]), radius, 8)
            (body if rng.random() < 0.5 else moving).append(barrel)
    return JointedParts((merge_meshes(body), merge_meshes(moving)), pivot[None])


def _dividers(rng: np.random.Generator, inner: Rect, low: float, high: float, thick: float) -> list[Mesh]:
    """Walls between compartments; the rectangle's second side runs along z."""
    across, along = int(rng.integers(0, 4)), int(rng.integers(0, 3))
    xs = np.linspace(inner.x0, inner.x1, across + 2)[1:-1]
    zs = np.linspace(inner.y0, inner.y1, along + 2)[1:-1]
    solids = [box((x - thick / 2, low - 1e-4, inner.y0), (x + thick / 2, high, inner.y1)) for x in xs]
    return solids + [box((inner.x0, low - 1e-4, z - thick / 2), (inner.x1, high, z + thick / 2)) for z in zs]


def _barrel(rng: np.random.Generator, width: float, depth: float, rim: float, tall: float) -> Lid:
    """The lid of a treasure chest: a part of a cylinder along x."""
    angle, rise = np.linspace(0.0, np.pi, 13), max(tall, 0.15 * depth)
    arc = points(0.0, rim + 0.001 + rise * np.sin(angle), depth / 2 * np.cos(angle))
    over = rng.uniform(0.0, 0.02) * width
    half = np.array([width / 2 + over, 0, 0])
    return Lid([loft(np.stack([arc - half, arc + half]))], rim + 0.001, 0.0, rim + rise)
