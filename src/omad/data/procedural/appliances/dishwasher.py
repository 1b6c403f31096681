"""Random dishwashers: built-in, free-standing and table-top, hollow or solid, with all kinds of doors and handles; some
with a door that is much lower than the body."""

from itertools import pairwise

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, column, cylinder, frame, sides, slab
from ..vocabulary.handles import handle_across
from ..vocabulary.racks import rack


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One dishwasher, door closed. Body on y = 0 .. height, its front plane at z = 0, the room at +z."""
    compact = rng.random() < 0.12
    width = rng.uniform(0.42, 0.7)
    depth = rng.uniform(0.42, 0.75)
    height = rng.uniform(0.42, 0.58) if compact else float(np.clip(rng.normal(0.78, 0.12), 0.55, 1.0))
    wall = rng.choice([rng.uniform(0.002, 0.01), rng.uniform(0.008, 0.05)])

    kick = height * rng.uniform(0.04, 0.18) if rng.random() < 0.65 else height * rng.uniform(0.0, 0.03)
    strip = height * rng.uniform(0.08, 0.2) if rng.random() < 0.4 else height * rng.uniform(0.0, 0.05)
    door_low, door_high = kick, height - strip
    if unusual:
        door_low, door_high = _lowered(unusual, door_low, door_high)
    inset = rng.random() < 0.3  # door between the walls, else in front of them
    margin = wall * rng.uniform(0.3, 1.0) if inset else width * rng.choice([0.0, rng.uniform(0.0, 0.03)])
    door_half = width / 2 - margin
    thickness = rng.uniform(0.015, 0.09)
    recess = thickness * rng.uniform(0.4, 1.1) if inset else 0.0
    back, front = -recess, thickness - recess

    body = _cabinet(rng, width, height, depth, wall, recess, door_low, door_high)
    body += _front_strips(rng, width, height, door_low, door_high, front)
    body += _top_and_feet(rng, width, height, depth, front)
    if unusual:
        body += _fixed_fronts(unusual, width / 2, ((kick, door_low), (door_high, height - strip)), front)
    hollow = rng.random() < 0.12
    door = _door(rng, door_half, door_low, door_high, back, front, hollow)
    if rng.random() < 0.7:
        door += handle_across(rng, door_half, door_low, door_high, front)
    if rng.random() < 0.45:
        door += _controls(rng, door_half, door_low, door_high, front)
    if not hollow and rng.random() < 0.6:
        door += _inner_panel(rng, door_half, door_low, door_high, back, door_half - width / 2 + wall)

    pivot_y = door_low + rng.choice([0.0, rng.uniform(-0.01, 0.045)])
    pivot_z = back + rng.uniform(0.0, 0.6) * thickness
    return JointedParts((merge_meshes(body), merge_meshes(door)), np.array([[0.0, pivot_y, pivot_z]]))


def _lowered(rng, low: float, high: float) -> tuple[float, float]:
    """Lower and upper edge of a door that fills only a part of ``low`` .. ``high``, at its top, bottom or between."""
    tall = (high - low) * rng.uniform(0.4, 0.75)
    low += (high - low - tall) * rng.choice([0.0, 1.0, rng.uniform()])
    return low, low + tall


def _fixed_fronts(rng, half: float, spans: tuple[tuple[float, float], ...], front: float) -> list[Mesh]:
    """What looks like a drawer's front above or below a low door, each between ``spans`` of y, with or without handle;
    or the body's bare front."""
    solids = []
    for low, high in spans:
        if high - low < 0.06 or rng.random() < 0.3:
            continue
        face = max(front * rng.uniform(0.5, 1.1), 0.004)
        margin = half * rng.uniform(0.0, 0.06)
        solids.append(slab((margin - half, low + 0.004, -0.01), (half - margin, high - 0.004, face), 2, 0.004))
        if rng.random() < 0.6:
            solids += handle_across(rng, half - margin, low + 0.01, high - 0.01, face)
    return solids


def _cabinet(rng, width, height, depth, wall, recess, door_low, door_high) -> list[Mesh]:
    """Walls around an open tub with racks, or a solid block with or without a shallow mouth."""
    x, inner, z0 = width / 2, width / 2 - wall, -depth
    if rng.random() < 0.2:
        return [box((-x, 0, z0), (x, height, -recess - 1e-3))]
    floor = max(door_low - wall * rng.uniform(0.0, 2.0), 0.01)
    ceiling = min(door_high + wall * rng.uniform(-1.0, 2.0), height - 0.008)
    rear = z0 + wall * rng.uniform(1.0, 3.0)
    if rng.random() < 0.2:
        rear = -depth * rng.uniform(0.3, 0.9)  # a shallow tub: machinery behind
    elif rng.random() < 0.08:
        rear = z0  # no back: models of built-in machines often are open there
    solids = [
        *sides((-x, 0, z0), (x, height, 0.0), wall),
        box((-inner, ceiling, rear), (inner, height, -recess * (ceiling < door_high) - 1e-3)),
        box((-inner, 0, rear), (inner, floor, -recess * (floor > door_low) - 1e-3)),
    ]
    if rear == z0:
        return solids
    solids.append(box((-inner, 0, z0), (inner, height, rear)))
    for level in sorted(rng.uniform(0.08, 0.8, int(rng.integers(0, 4)))):
        solids += rack(rng, inner - 0.02, floor + level * (ceiling - floor), ceiling, rear + 0.02, -recess - 0.03)
    return solids


def _front_strips(rng, width, height, door_low, door_high, front) -> list[Mesh]:
    """What closes the front above and below the door: control strip and kick plate."""
    solids = []
    x = width / 2 * rng.uniform(0.94, 1.0)
    if height - door_high > 0.03:
        reach, y = max(front * rng.uniform(0.3, 1.1), 0.004), (door_high + height) / 2
        solids.append(slab((-x, door_high + 0.003, -0.01), (x, height, reach), 2, 0.004))
        if rng.random() < 0.5:
            for s in rng.uniform(-0.8, 0.8, int(rng.integers(1, 6))):
                r = rng.uniform(0.006, 0.018)
                solids.append(cylinder((s * x, y, 0), (s * x, y, reach + rng.uniform(0.002, 0.02)), r))
    if door_low > 0.02 and rng.random() < 0.8:
        set_back = rng.uniform(0.0, 0.08) if rng.random() < 0.6 else -max(front, 0.003) * rng.uniform(0.2, 1.0)
        solids.append(box((-x, 0, -set_back - 0.02), (x, door_low - 0.003, -set_back)))
    return solids


def _top_and_feet(rng, width, height, depth, front) -> list[Mesh]:
    """A worktop that may stand over the front, feet."""
    solids = []
    if rng.random() < 0.4:
        over = max(front, 0.0) * rng.uniform(0.2, 1.3)
        x = width / 2 + rng.uniform(0.0, 0.015)
        high = x, height + rng.uniform(0.008, 0.05), over
        solids.append(slab((-x, height, -depth), high, 1, rng.uniform(0.0, 0.02)))
    if rng.random() < 0.35:
        drop, r = rng.uniform(0.01, 0.06), rng.uniform(0.01, 0.03)
        places = [(x * width, z * depth) for x in (-0.42, 0.42) for z in (-0.08, -0.92)]
        solids += [cylinder((x, -drop, z), (x, 0.02, z), r) for x, z in places]
    return solids


def _door(rng, half, low, high, back, front, hollow: bool) -> list[Mesh]:
    """The door's slab: bevelled, rounded, sometimes bowed towards the room."""
    radius, bevel = rng.uniform(0.0, 0.02), rng.uniform(0.0, 0.4) * (front - back)
    skin, rims = back, []
    if hollow:  # a skin with rims towards the tub
        skin = front - (front - back) * rng.uniform(0.1, 0.5)
        rim = rng.uniform(0.003, 0.04)
        rims = frame((-half, low, back), (half, high, skin), rim, rim)
        radius = min(radius, rim)
    leaf = slab((-half, low, skin), (half, high, front), 2, radius, bevel if rng.random() < 0.5 else 0.0)
    bow: list[Mesh] = []
    if rng.random() < 0.2:
        x = np.linspace(-half, half, 9)
        line = pairwise(zip(x, front + rng.uniform(0.01, 0.05) * (1 - (x / half) ** 2), strict=True))
        bow = [column(x0, x1, 0.5 * (front + skin), z0, z1, low, high) for (x0, z0), (x1, z1) in line]
    return [leaf, *rims, *bow]


def _controls(rng, half, low, high, front) -> list[Mesh]:
    """A control panel across the top of the door, with a display and buttons."""
    tall = (high - low) * rng.uniform(0.08, 0.2)
    step, y = rng.uniform(0.002, 0.025), high - tall / 2
    solids = [slab((-half, high - tall, front - 0.003), (half, high, front + step), 2, 0.003)]
    for s in rng.uniform(-0.85, 0.85, int(rng.integers(0, 6))):
        size = rng.uniform(0.005, 0.02)
        solids.append(box((s * half - size, y - size, front), (s * half + size, y + size, front + step + 0.006)))
    return solids


def _inner_panel(rng, half, low, high, back, lap: float) -> list[Mesh]:
    """The raised inner liner of the door, with the detergent dispenser; the door laps over the walls by ``lap``."""
    inset = max(half * rng.uniform(0.05, 0.15), lap + 0.004)
    step = rng.choice([rng.uniform(0.005, 0.03), rng.uniform(0.02, 0.07)])
    low_corner = (-half + inset, low + (high - low) * rng.uniform(0.05, 0.15), back - step)
    solids = [slab(low_corner, (half - inset, high - (high - low) * 0.08, back + 0.003), 2, rng.uniform(0.0, 0.03))]
    if rng.random() < 0.6:
        x, y = half * rng.uniform(-0.4, 0.3), low + (high - low) * rng.uniform(0.4, 0.7)
        w, h = rng.uniform(0.05, 0.12), rng.uniform(0.04, 0.08)
        solids.append(box((x - w, y - h, back - step - rng.uniform(0.005, 0.02)), (x + w, y + h, back)))
    return solids
