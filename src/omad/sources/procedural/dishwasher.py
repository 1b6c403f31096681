"""Random dishwashers: built-in, free-standing and table-top, hollow or solid, with all kinds of doors and handles."""

from __future__ import annotations

import numpy as np

from ...categories import DISHWASHER
from ...objects import Mesh, ObjectModel
from .shapes import box, cylinder, hexahedron, merge, slab, tube


def dishwasher(rng: np.random.Generator, name: str) -> ObjectModel:
    """One dishwasher, door closed. Body on y = 0 .. height, its front plane at z = 0, the room at +z."""
    compact = rng.random() < 0.12
    width = rng.uniform(0.42, 0.7)
    depth = rng.uniform(0.42, 0.75)
    height = rng.uniform(0.42, 0.58) if compact else float(np.clip(rng.normal(0.78, 0.12), 0.55, 1.0))
    wall = rng.choice([rng.uniform(0.002, 0.01), rng.uniform(0.008, 0.05)])

    kick = height * rng.uniform(0.04, 0.18) if rng.random() < 0.65 else height * rng.uniform(0.0, 0.03)
    strip = height * rng.uniform(0.08, 0.2) if rng.random() < 0.4 else height * rng.uniform(0.0, 0.05)
    door_low, door_high = kick, height - strip
    inset = rng.random() < 0.3  # door between the walls, else in front of them
    margin = wall * rng.uniform(0.3, 1.0) if inset else width * rng.choice([0.0, rng.uniform(0.0, 0.03)])
    door_half = width / 2 - margin
    thickness = rng.uniform(0.015, 0.09)
    recess = thickness * rng.uniform(0.4, 1.1) if inset else 0.0
    back, front = -recess, thickness - recess

    body = [*_cabinet(rng, width, height, depth, wall, recess, door_low, door_high)]
    body += _front_strips(rng, width, height, door_low, door_high, front)
    body += _top_and_feet(rng, width, height, depth, front)
    hollow = rng.random() < 0.12
    door = _door(rng, door_half, door_low, door_high, back, front, hollow)
    if rng.random() < 0.7:
        door += _handle(rng, door_half, door_low, door_high, front)
    if rng.random() < 0.45:
        door += _controls(rng, door_half, door_low, door_high, front)
    if not hollow and rng.random() < 0.6:
        door += _inner_panel(rng, door_half, door_low, door_high, back, door_half - width / 2 + wall)

    pivot_y = door_low + rng.choice([0.0, rng.uniform(-0.01, 0.045)])
    pivot_z = back + rng.uniform(0.0, 0.6) * thickness
    return ObjectModel(
        name=name,
        category=DISHWASHER.name,
        part_names=tuple(part.name for part in DISHWASHER.parts),
        parts=(merge(body), merge(door)),
        joint_names=tuple(joint.name for joint in DISHWASHER.joints),
        tree=DISHWASHER.tree,
        axes=np.array([DISHWASHER.joints[0].axis]),
        pivots=np.array([[0.0, pivot_y, pivot_z]]),
        limits=np.array([DISHWASHER.joints[0].limits]),
    ).centred()


def _cabinet(rng, width, height, depth, wall, recess, door_low, door_high) -> list[Mesh]:
    """Walls around an open tub with racks, or a solid block with or without a shallow mouth."""
    x, z0, z1 = width / 2, -depth, 0.0
    if rng.random() < 0.2:
        return [box((-x, 0, z0), (x, height, -recess - 1e-3))]
    floor = max(door_low - wall * rng.uniform(0.0, 2.0), 0.01)
    ceiling = min(door_high + wall * rng.uniform(-1.0, 2.0), height - 0.008)
    rear = z0 + wall * rng.uniform(1.0, 3.0)
    if rng.random() < 0.2:
        rear = z1 - depth * rng.uniform(0.3, 0.9)  # a shallow tub: machinery behind
    elif rng.random() < 0.08:
        rear = z0  # no back: models of built-in machines often are open there
    solids = [
        box((-x, 0, z0), (-x + wall, height, z1)),
        box((x - wall, 0, z0), (x, height, z1)),
        box((-x + wall, ceiling, rear), (x - wall, height, z1 - recess * (ceiling < door_high) - 1e-3)),
        box((-x + wall, 0, rear), (x - wall, floor, z1 - recess * (floor > door_low) - 1e-3)),
    ]
    if rear == z0:
        return solids
    solids.append(box((-x + wall, 0, z0), (x - wall, height, rear)))
    tub = (-x + wall, x - wall, floor, ceiling, rear, -max(recess, 0.0) - 0.03)
    for level in sorted(rng.uniform(0.08, 0.8, int(rng.integers(0, 4)))):
        solids += _rack(rng, tub, level)
    return solids


def _rack(rng, tub, level: float) -> list[Mesh]:
    """A dish rack: a shelf of bars or a tray, sometimes with sides, sometimes with plates in it."""
    x0, x1, y0, y1, z0, z1 = tub
    gap, bar = 0.02, rng.uniform(0.002, 0.006)
    x0, x1, z0, z1 = x0 + gap, x1 - gap, z0 + gap, z1
    y = y0 + level * (y1 - y0)
    if x1 - x0 < 0.1 or z1 - z0 < 0.1:
        return []
    solids = []
    if rng.random() < 0.4:
        solids.append(box((x0, y - bar, z0), (x1, y + bar, z1)))
    else:
        for x in np.linspace(x0, x1, int(rng.integers(5, 12))):
            solids.append(box((x - bar, y - bar, z0), (x + bar, y + bar, z1)))
        for z in np.linspace(z0, z1, int(rng.integers(3, 7))):
            solids.append(box((x0, y - bar, z - bar), (x1, y + bar, z + bar)))
    if rng.random() < 0.6:
        rise = min(rng.uniform(0.03, 0.1), y1 - y - 0.01)
        if rise > 0.01:
            for a, b in (((x0, z0), (x0, z1)), ((x1, z0), (x1, z1)), ((x0, z1), (x1, z1))):
                for h in (0.5 * rise, rise):
                    low = (a[0] - bar, y + h - bar, a[1] - bar)
                    solids.append(box(low, (b[0] + bar, y + h + bar, b[1] + bar)))
    return solids


def _front_strips(rng, width, height, door_low, door_high, front) -> list[Mesh]:
    """What closes the front above and below the door: control strip and kick plate."""
    solids = []
    x = width / 2 * rng.uniform(0.94, 1.0)
    if height - door_high > 0.03:
        reach = front * rng.uniform(0.3, 1.1)
        solids.append(slab((-x, door_high + 0.003, -0.01), (x, height, max(reach, 0.004)), 2, 0.004))
        if rng.random() < 0.5:
            for s in rng.uniform(-0.8, 0.8, int(rng.integers(1, 6))):
                y, r = (door_high + height) / 2, rng.uniform(0.006, 0.018)
                solids.append(cylinder((s * x, y, 0), (s * x, y, max(reach, 0.004) + rng.uniform(0.002, 0.02)), r))
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
        low, high = (-x, height, -depth), (x, height + rng.uniform(0.008, 0.05), over)
        solids.append(slab(low, high, 1, rng.uniform(0.0, 0.02)))
    if rng.random() < 0.35:
        drop, r = rng.uniform(0.01, 0.06), rng.uniform(0.01, 0.03)
        for x in (-0.42, 0.42):
            for z in (-0.08, -0.92):
                solids.append(cylinder((x * width, -drop, z * depth), (x * width, 0.02, z * depth), r))
    return solids


def _door(rng, half, low, high, back, front, hollow: bool) -> list[Mesh]:
    """The door's slab: bevelled, rounded, sometimes bowed towards the room."""
    radius, bevel = rng.uniform(0.0, 0.02), rng.uniform(0.0, 0.4) * (front - back)
    skin = back
    rims = []
    if hollow:  # a skin with rims towards the tub
        skin = front - (front - back) * rng.uniform(0.1, 0.5)
        rim = rng.uniform(0.003, 0.04)
        rims = [
            box((-half, low, back), (-half + rim, high, skin)),
            box((half - rim, low, back), (half, high, skin)),
            box((-half + rim, low, back), (half - rim, low + rim, skin)),
            box((-half + rim, high - rim, back), (half - rim, high, skin)),
        ]
        radius = min(radius, rim)
    leaf = slab((-half, low, skin), (half, high, front), 2, radius, bevel if rng.random() < 0.5 else 0.0)
    if rng.random() < 0.2:
        columns = np.linspace(-half, half, 9)
        bow = rng.uniform(0.01, 0.05)
        curve = front + bow * (1 - (columns / half) ** 2)
        return [leaf, *rims, _bowed(columns, low, high, 0.5 * (front + skin), curve)]
    return [leaf, *rims]


def _bowed(columns: np.ndarray, low: float, high: float, back: float, curve: np.ndarray) -> Mesh:
    """Columns side by side, each from the plane ``back`` to the curve."""
    solids = []
    for x0, x1, z0, z1 in zip(columns[:-1], columns[1:], curve[:-1], curve[1:], strict=True):
        ring = np.array([[x0, 0, back], [x1, 0, back], [x1, 0, z1], [x0, 0, z0]])
        solids.append(hexahedron(np.concatenate([ring + [0, low, 0], ring + [0, high, 0]])))
    return merge(solids)


def _handle(rng, half, low, high, front) -> list[Mesh]:
    """Bar on two posts, round or flat; a ledge; a knob; a raised frame around a pocket."""
    y = high - (high - low) * rng.uniform(0.04, 0.22)
    reach, grip = rng.uniform(0.02, 0.07), rng.uniform(0.006, 0.02)
    span = half * rng.uniform(0.3, 0.95)
    kind = rng.random()
    if kind < 0.5:
        posts = [
            box((s * span - grip, y - grip, front - 0.003), (s * span + grip, y + grip, front + reach)) for s in (-1, 1)
        ]
        if rng.random() < 0.5:
            return [*posts, cylinder((-span - grip, y, front + reach), (span + grip, y, front + reach), grip)]
        low_corner, high_corner = (
            (-span - grip, y - 1.5 * grip, front + reach - grip),
            (span + grip, y + 1.5 * grip, 0),
        )
        return [*posts, slab(low_corner, (*high_corner[:2], front + reach + 0.5 * grip), 2, grip)]
    if kind < 0.65:  # an arch, bowed towards the room and sometimes up or down
        s = np.linspace(-1, 1, 9)
        rise = 1 - np.abs(s) ** rng.uniform(2.0, 8.0)
        drop = (high - y) * rng.uniform(-0.5, 0.5) * (rng.random() < 0.4)
        return [tube(np.stack([s * span, y + drop * rise, front - 0.003 + reach * rise], 1), grip)]
    if kind < 0.78:
        return [box((-span, y - grip, front - 0.003), (span, y + grip, front + 0.6 * reach))]
    if kind < 0.87:
        return [cylinder((0, y, front - 0.003), (0, y, front + reach), 1.5 * grip)]
    tall, rim = rng.uniform(0.02, 0.05), 0.4 * grip
    return [
        box((-span, y + tall, front - 0.003), (span, y + tall + rim, front + 0.3 * reach)),
        box((-span, y - tall - rim, front - 0.003), (span, y - tall, front + 0.3 * reach)),
    ]


def _controls(rng, half, low, high, front) -> list[Mesh]:
    """A control panel across the top of the door, with a display and buttons."""
    tall = (high - low) * rng.uniform(0.08, 0.2)
    step = rng.uniform(0.002, 0.025)
    solids = [slab((-half, high - tall, front - 0.003), (half, high, front + step), 2, 0.003)]
    y = high - tall / 2
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
