"""Random laptops: proportions, thickness, hinges and surface relief of real ones, from netbooks to old heavy ones."""

from __future__ import annotations

import numpy as np

from ...categories import LAPTOP
from ...objects import Mesh, ObjectModel
from .shapes import box, cylinder, merge, slab, warp


def laptop(rng: np.random.Generator, name: str) -> ObjectModel:
    """One laptop, screen upright. Base on y = 0 .. top, hinge near z = 0, front towards +z."""
    unit = LAPTOP.metres_per_unit
    width = unit * float(np.clip(rng.normal(1.25, 0.14), 0.9, 1.65))
    depth = width * float(np.clip(rng.normal(0.71, 0.08), 0.52, 0.95))
    thickness = unit * float(np.clip(np.exp(rng.normal(np.log(0.055), 0.5)), 0.018, 0.17))
    radius = unit * rng.choice([0.002, rng.uniform(0.01, 0.09)])
    bevel = rng.uniform(0, 0.4) * thickness if rng.random() < 0.6 else 0.0

    base = slab((-width / 2, 0, 0), (width / 2, thickness, depth), 1, radius, bevel)
    wedge = rng.uniform(0.35, 1.0) if rng.random() < 0.5 else 1.0
    base = warp(base, lambda v: _wedge(v, thickness, depth, wedge, from_top=rng.random() < 0.3))
    top = _deck_height(base, 0.0)

    screen_thickness = unit * float(np.clip(np.exp(rng.normal(np.log(0.038), 0.45)), 0.012, 0.1))
    screen_width = width * (rng.uniform(0.92, 1.03) if rng.random() < 0.4 else 1.0)
    # where the hinge lies: its height above the deck, and how far in front of the back edge
    if rng.random() < 0.25:  # drop hinge: the screen's foot hangs behind the base
        rise = -rng.uniform(0.1, 0.8) * thickness
        hinge_z = -rng.uniform(0.0, 0.6) * screen_thickness
        foot = rng.uniform(-0.3, 0.3) * thickness
        face = hinge_z - rng.uniform(0.0, 0.005)
    else:
        rise = rng.uniform(-0.2, 1.0) * screen_thickness
        hinge_z = depth * rng.choice([rng.uniform(-0.03, 0.02), rng.uniform(0.02, 0.1)])
        foot = rng.uniform(0.0, 0.03) * depth + max(0.0, -rise)
        face = hinge_z + rise - rng.uniform(0.0, 0.004)
        if rng.random() < 0.25:  # the screen's foot stands in a notch of the base
            foot = -rise - rng.uniform(0.1, 0.7) * min(thickness, 0.06 * unit)
    hinge_y = top + rise
    reach = depth - hinge_z
    height = max(reach * float(np.clip(rng.normal(0.97, 0.06), 0.78, 1.12)), 0.5 * depth)
    low = (-screen_width / 2, hinge_y + foot, face - screen_thickness)
    high = (screen_width / 2, hinge_y + height, face)
    screen_bevel = rng.uniform(0, 0.4) * screen_thickness if rng.random() < 0.6 else 0.0
    screen = slab(low, high, 2, radius * rng.uniform(0.5, 1.3), screen_bevel)
    if rng.random() < 0.4:  # a domed lid
        bulge = rng.uniform(0.1, 0.8) * screen_thickness
        screen = warp(screen, lambda v: _dome(v, low, high, bulge))

    base_solids = [base, *_deck(rng, width, depth, hinge_z, lambda z: _deck_height(base, z), unit)]
    base_solids += _underside(rng, width, depth, thickness, unit)
    screen_solids = [screen, *_screen_relief(rng, low, high, unit)]
    for solids, barrels in zip((base_solids, screen_solids), _barrels(rng, width, hinge_y, hinge_z, foot), strict=True):
        solids += barrels
    return ObjectModel(
        name=name,
        category=LAPTOP.name,
        part_names=tuple(part.name for part in LAPTOP.parts),
        parts=(merge(base_solids), merge(screen_solids)),
        joint_names=tuple(joint.name for joint in LAPTOP.joints),
        tree=LAPTOP.tree,
        axes=np.array([LAPTOP.joints[0].axis]),
        pivots=np.array([[0.0, hinge_y, hinge_z]]),
        limits=np.array([LAPTOP.joints[0].limits]),
    ).centred()


def _wedge(vertices: np.ndarray, thickness: float, depth: float, front: float, from_top: bool) -> np.ndarray:
    """Thin the front to the share ``front`` of the thickness, by sloping the deck or the underside."""
    share = 1 + (front - 1) * vertices[:, 2] / depth
    y = vertices[:, 1] * share if from_top else thickness - (thickness - vertices[:, 1]) * share
    return np.stack([vertices[:, 0], y, vertices[:, 2]], 1)


def _deck_height(base: Mesh, z: float) -> float:
    """Height of the base's top at depth ``z``, from the vertices of its upper outline."""
    vertices = base.vertices
    back, front = (
        vertices[vertices[:, 2] < vertices[:, 2].mean()],
        vertices[vertices[:, 2] > vertices[:, 2].mean()],
    )
    y0, y1 = back[:, 1].max(), front[:, 1].max()
    z0, z1 = back[back[:, 1].argmax(), 2], front[front[:, 1].argmax(), 2]
    return float(y0 + (y1 - y0) * (z - z0) / (z1 - z0))


def _dome(vertices: np.ndarray, low, high, bulge: float) -> np.ndarray:
    """Push the back of the screen out in the middle; its vertices there lie on the outline and centre only."""
    u = (2 * vertices[:, 0] - low[0] - high[0]) / (high[0] - low[0])
    v = (2 * vertices[:, 1] - low[1] - high[1]) / (high[1] - low[1])
    behind = vertices[:, 2] < (low[2] + high[2]) / 2
    push = bulge * (1 - np.clip(u**2, 0, 1)) * (1 - np.clip(v**2, 0, 1)) * behind
    return vertices - np.stack([0 * push, 0 * push, push], 1)


def _deck(rng, width: float, depth: float, hinge_z: float, deck, unit: float) -> list[Mesh]:
    """Keyboard, touchpad and palm rest, in slight relief."""
    solids = []
    half = width * rng.uniform(0.38, 0.48)
    back = hinge_z + depth * rng.uniform(0.06, 0.16)
    front = back + depth * rng.uniform(0.32, 0.45)
    relief = unit * rng.uniform(0.003, 0.015)
    kind = rng.random()
    if kind < 0.5:  # single keys
        rows, columns = int(rng.integers(4, 7)), int(rng.integers(8, 14))
        zs, xs = np.linspace(back, front, rows + 1), np.linspace(-half, half, columns + 1)
        gap = rng.uniform(0.1, 0.25)
        for z0, z1 in zip(zs[:-1], zs[1:], strict=True):
            y = deck((z0 + z1) / 2)
            for x0, x1 in zip(xs[:-1], xs[1:], strict=True):
                dx, dz = gap * (x1 - x0), gap * (z1 - z0)
                solids.append(box((x0, y - relief, z0), (x1 - dx, y + relief, z1 - dz)))
    elif kind < 0.75:  # a block of keys
        y = deck((back + front) / 2)
        solids.append(box((-half, y - relief, back), (half, y + relief, front)))
    if rng.random() < 0.5:
        w, z0 = width * rng.uniform(0.1, 0.2), front + depth * rng.uniform(0.04, 0.1)
        z1 = min(z0 + depth * rng.uniform(0.12, 0.28), 0.97 * depth)
        y = deck((z0 + z1) / 2)
        solids.append(box((-w, y - relief, z0), (w, y + 0.4 * relief, z1)))
    return solids


def _underside(rng, width: float, depth: float, thickness: float, unit: float) -> list[Mesh]:
    """Feet and a battery bulge."""
    solids = []
    if rng.random() < 0.4:
        size, drop = unit * rng.uniform(0.02, 0.05), unit * rng.uniform(0.005, 0.02)
        for x in (-0.42, 0.42):
            for z in (0.08, 0.92):
                a, b = x * width, z * depth
                solids.append(box((a - size, -drop, b - size), (a + size, 0.3 * thickness, b + size)))
    if rng.random() < 0.15:
        half, behind = width * rng.uniform(0.25, 0.45), depth * rng.uniform(0.02, 0.08)
        solids.append(box((-half, 0.1 * thickness, -behind), (half, 0.8 * thickness, 0.1 * depth)))
    return solids


def _screen_relief(rng, low, high, unit: float) -> list[Mesh]:
    """A raised bezel around the panel, a webcam bump."""
    (x0, y0, _), (x1, y1, face) = low, high
    solids = []
    if rng.random() < 0.5:
        rim, relief = unit * rng.uniform(0.02, 0.09), unit * rng.uniform(0.003, 0.015)
        back = face - relief
        chin = rim * rng.uniform(1.0, 2.5)
        solids = [
            box((x0, y0, back), (x0 + rim, y1, face + relief)),
            box((x1 - rim, y0, back), (x1, y1, face + relief)),
            box((x0 + rim, y1 - rim, back), (x1 - rim, y1, face + relief)),
            box((x0 + rim, y0, back), (x1 - rim, y0 + chin, face + relief)),
        ]
    if rng.random() < 0.1:
        size = unit * rng.uniform(0.02, 0.05)
        solids.append(box((-size, y1 - size / 2, face - size), (size, y1 + size / 2, face + size / 2)))
    return solids


def _barrels(rng, width: float, y: float, z: float, foot: float) -> tuple[list[Mesh], list[Mesh]]:
    """Hinge barrels along the axis: some turn with the screen, some stay with the base."""
    kind = rng.random()
    if kind < 0.35:
        return [], []
    radius = max(abs(foot), 0.004) * rng.uniform(0.8, 1.3)
    if kind < 0.6:  # one long barrel
        half = width * rng.uniform(0.25, 0.45)
        bars = [cylinder((-half, y, z), (half, y, z), radius)]
    else:
        inner, length = width * rng.uniform(0.25, 0.4), width * rng.uniform(0.05, 0.12)
        bars = [cylinder((s * inner, y, z), (s * (inner + length), y, z), radius) for s in (-1, 1)]
    return (bars, []) if rng.random() < 0.5 else ([], bars)
