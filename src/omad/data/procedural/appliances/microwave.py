"""Random microwave ovens: boxy or rounded, with a door left of the controls, with all kinds of windows and handles."""

from dataclasses import replace

import numpy as np

from omad.geometry.mesh import merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder
from ..vocabulary.cases import Case, Rect, controls
from ..vocabulary.doors import fitted, leaf, liner, pivot_at_side
from ..vocabulary.handles import handle
from ..vocabulary.stands import feet

MOST = 0.8
"""Share of the height that the walls below and above the cavity have at most together."""


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One microwave, door closed, hinged at the left. Body on y = 0 .. height, its front plane at z = 0. The
    door of unusual ones leaves much of the front free all around."""
    width = rng.uniform(0.4, 0.62)
    height, depth = width * rng.uniform(0.45, 0.7), width * rng.uniform(0.55, 0.85)
    wall = rng.choice([rng.uniform(0.004, 0.012), rng.uniform(0.01, 0.04)])
    panel = width * (rng.uniform(0.16, 0.34) if rng.random() < 0.9 else 0.06)  # some have their controls below
    low, high = wall * rng.uniform(0.8, 2.5, 2)
    if panel < 0.07 * width:
        low += 0.15 * height
    back = depth * rng.choice([rng.uniform(0.02, 0.1), rng.uniform(0.1, 0.3)])
    left = wall * rng.uniform(1.0, 2.5)
    if unusual:
        left, low, high = unusual.uniform(0.05, 0.15) * width, *unusual.uniform(0.06, 0.2, 2) * height
    low, high = min(1.0, MOST * height / (low + high)) * np.array([low, high])
    case = Case(width, height, depth, left, panel, low, high, back)
    front, mouth = case.front, case.mouth

    thickness = rng.choice([rng.uniform(0.008, 0.025), rng.uniform(0.02, 0.06)])
    lap = panel * rng.uniform(0.05, 0.25)
    outer = replace(front, x1=mouth.x1 + lap)
    if panel < 0.07 * width:
        outer = replace(front, y0=mouth.y0 - 0.3 * low)
    if unusual:
        free = unusual.uniform(0.3, 0.9) * np.array([mouth.x0 - outer.x0, mouth.y0 - outer.y0, mouth.y1 - outer.y1])
        outer = replace(outer, x0=outer.x0 + free[0], y0=outer.y0 + free[1], y1=outer.y1 + free[2])
    door, body = fitted(rng, outer, mouth, thickness)
    pivot = pivot_at_side(rng, door, thickness, bool(body))

    beside = Rect(outer.x1 + 0.001, front.x1, front.y0, front.y1)
    if outer.x1 == front.x1:
        beside = Rect(front.x0, front.x1, front.y0, outer.y0 - 0.001)
    face = thickness * rng.choice([1.0, rng.uniform(0.0, 1.1)])
    crude = rng.random() < 0.12  # a block without a cavity
    body += [front.slab(-depth, 0.0)] if crude else case.walls()
    body.append(beside.slab(-0.004, max(face, 0.001)))
    body += controls(rng, beside.grown(-0.12 * min(beside.width, beside.height)), max(face, 0.001), 5)
    body += feet(rng, width / 2, depth, 0.03)
    if not crude and rng.random() < 0.6:  # the turntable
        x, z = mouth.centre[0], -(depth - back) * 0.5
        radius = min(mouth.width, depth - back) * rng.uniform(0.3, 0.46)
        body.append(cylinder((x, mouth.y0, z), (x, mouth.y0 + rng.uniform(0.004, 0.02), z), radius, 24))
    if rng.random() < 0.1:  # a bulge for the fan behind
        half = width * rng.uniform(0.15, 0.4)
        body.append(box((-half, 0.2 * height, -depth - rng.uniform(0.005, 0.03)), (half, 0.8 * height, -depth)))

    moving = leaf(rng, door, 0.0005, thickness, windows=0.45, panels=0.3)
    if rng.random() < 0.6:
        moving += handle(rng, door, thickness, "right", rng.uniform(0.4, 0.9))
    if not crude and rng.random() < 0.4:
        moving += liner(rng, door, 0.0, mouth, 0.02)
    return JointedParts((merge_meshes(body), merge_meshes(moving)), pivot[None])
