"""Random laptops: proportions, thickness, hinges and surface relief of real ones, from netbooks to old heavy ones."""

from collections.abc import Callable
from itertools import pairwise, product

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder, frame, points, slab


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One laptop, screen upright. Base on y = 0 .. top, hinge near z = 0, front towards +z."""
    unit = category.metres_per_unit
    width = unit * float(np.clip(rng.normal(1.25, 0.14), 0.9, 1.65))
    depth = width * float(np.clip(rng.normal(0.71, 0.08), 0.52, 0.95))
    thickness = unit * float(np.clip(np.exp(rng.normal(np.log(0.055), 0.5)), 0.018, 0.17))
    radius = unit * rng.choice([0.002, rng.uniform(0.01, 0.09)])
    bevel = rng.uniform(0, 0.4) * thickness if rng.random() < 0.6 else 0.0

    base = slab((-width / 2, 0, 0), (width / 2, thickness, depth), 1, radius, bevel)
    wedge = rng.uniform(0.35, 1.0) if rng.random() < 0.5 else 1.0
    base = base.warped(lambda v: _wedge(v, thickness, depth, wedge, from_top=rng.random() < 0.3))
    deck = _deck_height(base)

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
    hinge_y = deck(0.0) + rise
    reach = depth - hinge_z
    height = max(reach * float(np.clip(rng.normal(0.97, 0.06), 0.78, 1.12)), 0.5 * depth)
    low, high = (-screen_width / 2, hinge_y + foot, face - screen_thickness), (screen_width / 2, hinge_y + height, face)
    screen_bevel = rng.uniform(0, 0.4) * screen_thickness if rng.random() < 0.6 else 0.0
    screen = slab(low, high, 2, radius * rng.uniform(0.5, 1.3), screen_bevel)
    if rng.random() < 0.4:  # a domed lid
        bulge = rng.uniform(0.1, 0.8) * screen_thickness
        screen = screen.warped(lambda v: _dome(v, low, high, bulge))

    base_solids = [base, *_deck(rng, width, depth, hinge_z, deck, unit)]
    base_solids += _underside(rng, width, depth, thickness, unit)
    screen_solids = [screen, *_screen_relief(rng, low, high, unit)]
    if barrels := _barrels(rng, width, hinge_y, hinge_z, foot):
        (base_solids if rng.random() < 0.5 else screen_solids).extend(barrels)
    return JointedParts((merge_meshes(base_solids), merge_meshes(screen_solids)), np.array([[0.0, hinge_y, hinge_z]]))


def _wedge(vertices: np.ndarray, thickness: float, depth: float, front: float, from_top: bool) -> np.ndarray:
    """Thin the front to the share ``front`` of the thickness, by sloping the deck or the underside."""
    x, y, z = vertices.T
    share = 1 + (front - 1) * z / depth
    return points(x, y * share if from_top else thickness - (thickness - y) * share, z)


def _deck_height(base: Mesh) -> Callable[[float], float]:
    """Height of the base's top by depth z, from the vertices of its upper outline."""
    middle = base.vertices[:, 2].mean()
    back, front = base.vertices[base.vertices[:, 2] < middle], base.vertices[base.vertices[:, 2] > middle]
    (_, y0, z0), (_, y1, z1) = back[back[:, 1].argmax()], front[front[:, 1].argmax()]
    return lambda z: float(y0 + (y1 - y0) * (z - z0) / (z1 - z0))


def _dome(vertices: np.ndarray, low, high, bulge: float) -> np.ndarray:
    """Push the back of the screen out in the middle; its vertices there lie on the outline and centre only."""
    u = (2 * vertices[:, 0] - low[0] - high[0]) / (high[0] - low[0])
    v = (2 * vertices[:, 1] - low[1] - high[1]) / (high[1] - low[1])
    behind = vertices[:, 2] < (low[2] + high[2]) / 2
    push = bulge * (1 - np.clip(u**2, 0, 1)) * (1 - np.clip(v**2, 0, 1)) * behind
    return vertices - points(0.0, 0.0, push)


def _deck(rng, width: float, depth: float, hinge_z: float, deck: Callable[[float], float], unit: float) -> list[Mesh]:
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
        for (z0, z1), (x0, x1) in product(pairwise(zs), pairwise(xs)):
            y = deck((z0 + z1) / 2)
            solids.append(box((x0, y - relief, z0), (x1 - gap * (x1 - x0), y + relief, z1 - gap * (z1 - z0))))
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
        places = [(x * width, z * depth) for x in (-0.42, 0.42) for z in (0.08, 0.92)]
        solids += [box((x - size, -drop, z - size), (x + size, 0.3 * thickness, z + size)) for x, z in places]
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
        chin = rim * rng.uniform(1.0, 2.5)
        left, right, bottom, top = frame((x0, y0, face - relief), (x1, y1, face + relief), rim, chin)
        solids = [left, right, top, bottom]
    if rng.random() < 0.1:
        size = unit * rng.uniform(0.02, 0.05)
        solids.append(box((-size, y1 - size / 2, face - size), (size, y1 + size / 2, face + size / 2)))
    return solids


def _barrels(rng, width: float, y: float, z: float, foot: float) -> list[Mesh]:
    """Hinge barrels along the axis, or none: some turn with the screen, some stay with the base."""
    kind = rng.random()
    if kind < 0.35:
        return []
    radius = max(abs(foot), 0.004) * rng.uniform(0.8, 1.3)
    if kind < 0.6:  # one long barrel
        half = width * rng.uniform(0.25, 0.45)
        return [cylinder((-half, y, z), (half, y, z), radius)]
    inner, length = width * rng.uniform(0.25, 0.4), width * rng.uniform(0.05, 0.12)
    return [cylinder((s * inner, y, z), (s * (inner + length), y, z), radius) for s in (-1, 1)]
