"""Random safes: thick walls, a thick door with a keypad, a dial or a wheel."""

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder, slab
from ..vocabulary.cases import Case, Rect, controls, shelves
from ..vocabulary.doors import fitted, liner, pivot_at_side
from ..vocabulary.handles import handle
from ..vocabulary.stands import feet


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One safe, shut, its door hinged at the left. Body on y = 0 .. height, its front plane at z = 0."""
    width = rng.uniform(0.33, 0.56)
    height = width * (rng.uniform(0.6, 1.0) if rng.random() < 0.55 else rng.uniform(1.0, 1.35))
    depth = width * rng.uniform(0.7, 1.1)
    wall = width * rng.choice([rng.uniform(0.015, 0.05), rng.uniform(0.04, 0.16)])
    sides = wall * rng.uniform(0.8, 2.0, 2)
    case = Case(width, height, depth, sides[0], sides[1], *(wall * rng.uniform(0.8, 1.6, 3)))
    thickness = rng.uniform(0.012, 0.12) * width
    door, body = fitted(rng, case.front, case.mouth, thickness, 0.6)
    pivot = pivot_at_side(rng, door, thickness, bool(body))
    crude = rng.random() < 0.1
    body += [case.front.slab(-depth, 0.0)] if crude else [*case.walls(), *shelves(rng, case, 2, 0.15 * depth)]
    body += feet(rng, width / 2, depth, 0.04)
    if rng.random() < 0.25:  # a rim of the front that stands out sideways
        flange = case.front.grown(rng.uniform(0.005, 0.02))
        body += [box((flange.x0, flange.y0, -0.02), (case.front.x0, flange.y1, 0.0))]
        body += [box((case.front.x1, flange.y0, -0.02), (flange.x1, flange.y1, 0.0))]
    bevel = rng.choice([0.0, rng.uniform(0.0, 0.4)]) * thickness
    moving = [slab((door.x0, door.y0, 0.0005), (door.x1, door.y1, thickness), 2, rng.uniform(0.0, 0.02), bevel)]
    if rng.random() < 0.4:
        moving.append(
            door.grown(-rng.uniform(0.06, 0.16) * door.width).slab(
                thickness - 0.001, thickness * rng.uniform(1.05, 1.3)
            )
        )
    if rng.random() < 0.4:  # hinges that are seen
        for y in door.centre[1] + door.height * np.array([-0.35, 0.35]):
            half, radius = 0.06 * door.height, min(0.4 * thickness, 0.012)
            moving.append(cylinder((pivot[0], y - half, pivot[2]), (pivot[0], y + half, pivot[2]), radius))
    moving += _lock(rng, door, thickness)
    if not crude and rng.random() < 0.8:
        moving += liner(rng, door, 0.0, case.mouth, 0.12 * width)
    return JointedParts((merge_meshes(body), merge_meshes(moving)), pivot[None])


def _lock(rng: np.random.Generator, door: Rect, front: float) -> list[Mesh]:
    """Some of: a field of keys, a dial, a wheel with spokes, a lever, a plain handle."""
    solids: list[Mesh] = []
    size = 0.12 * min(door.width, door.height)
    (cx, cy), x = door.centre, rng.uniform(-0.1, 0.25) * door.width
    tip = 1.3 * front
    if rng.random() < 0.5:
        half = size * rng.uniform(0.7, 1.6)
        at = Rect(cx + x - half, cx + x + half, cy + half * 0.2, cy + 2.2 * half)
        solids += [at.slab(front - 0.002, tip + 0.004), *controls(rng, at, tip + 0.004, 5)]
    kind = rng.random()
    y = cy - rng.uniform(0.0, 0.2) * door.height
    if kind < 0.3:  # a dial
        solids.append(cylinder((cx + x, y, front - 0.002), (cx + x, y, tip + size * rng.uniform(0.2, 0.7)), size, 20))
    elif kind < 0.6:  # a wheel or a lever with some spokes
        reach, count = tip + size * rng.uniform(0.4, 1.0), int(rng.integers(1, 6))
        solids.append(cylinder((cx + x, y, front - 0.002), (cx + x, y, reach), 0.3 * size, 12))
        for angle in rng.uniform(0, np.pi) + np.arange(count) * 2 * np.pi / count:
            end = (cx + x + 1.4 * size * np.cos(angle), y + 1.4 * size * np.sin(angle), reach - 0.1 * size)
            solids.append(cylinder((cx + x, y, reach - 0.1 * size), end, 0.12 * size, 8))
    elif kind < 0.8:
        solids += handle(rng, door, tip - 0.3 * front, "right", rng.uniform(0.3, 0.6))
    return solids
