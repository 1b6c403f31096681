"""Doors: their leaves, what is behind them, and where they hang; and fronts that do not open."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from omad.geometry.mesh import Mesh

from ..shapes import box, column, frame, slab
from .cases import Rect, surround
from .handles import handle


def fitted(
    rng: np.random.Generator, outer: Rect, mouth: Rect, thickness: float, let_in: float = 0.3
) -> tuple[Rect, list[Mesh]]:
    """Where a door ``thickness`` thick goes that closes ``mouth`` and stays within ``outer``: before all of it, or
    less; a share ``let_in`` of the time in a frame around it, which is the body's and comes with it."""
    framed = rng.random() < let_in
    share = rng.uniform(0.3, 0.8, 4) if framed else rng.uniform(0.0, 0.6, 4) * (rng.random() < 0.5)
    door = Rect(
        outer.x0 + share[0] * (mouth.x0 - outer.x0),
        outer.x1 + share[1] * (mouth.x1 - outer.x1),
        outer.y0 + share[2] * (mouth.y0 - outer.y0),
        outer.y1 + share[3] * (mouth.y1 - outer.y1),
    )
    if not framed:
        return door, []
    gap = max(0.0015, 0.6 * thickness**2 / door.width)  # its corner swings out further than its edge
    return door.grown(-gap, -0.0015), surround(outer, door, -0.002, thickness * rng.uniform(0.6, 1.0))


def pivot_at_side(rng: np.random.Generator, door: Rect, thickness: float, let_in: bool) -> np.ndarray:
    """(3,) a place of the left, upright hinge of a door between z = 0 and ``thickness``, from which it swings clear of
    the body by more than a right angle. One that is let into a frame hangs at its front, as it would jam otherwise."""
    if let_in:
        return np.array([door.x0, 0.0, thickness])
    depth = thickness * rng.uniform(0.35, 1.0)
    return np.array([door.x0 + rng.choice([0.0, rng.uniform(0.0, 0.25)]) * depth, 0.0, depth])


def leaf(
    rng: np.random.Generator, door: Rect, back: float, front: float, windows: float = 0.0, panels: float = 0.3
) -> list[Mesh]:
    """A door between two planes: a slab, bevelled or rounded, flat or bowed or hollow behind; a share ``windows`` of
    the time a frame around a pane, a share ``panels`` of the rest a frame around a sunk or raised field."""
    thick, small, kind = front - back, min(door.width, door.height), rng.random()
    low, high = (door.x0, door.y0, back), (door.x1, door.y1, front)
    radius = rng.choice([0.0, rng.uniform(0.0, 0.06)]) * small
    if kind < windows:
        return _with_window(rng, door, back, front)
    if kind < windows + (1 - windows) * panels:
        rim, foot = rng.uniform(0.08, 0.22, 2) * small
        inner = Rect(door.x0 + rim, door.x1 - rim, door.y0 + foot, door.y1 - rim)
        sunk = thick * rng.uniform(0.15, 0.6)
        solids = [*frame(low, high, rim, foot), inner.slab(back, front - sunk)]
        if rng.random() < 0.4:
            solids.append(inner.grown(-0.25 * rim).slab(back + 0.3 * thick, front - sunk * rng.uniform(0.0, 0.7)))
        return solids
    if kind > 0.92:
        return pressed(rng, door, back, front, radius)
    solids = [slab(low, high, 2, radius, rng.choice([0.0, rng.uniform(0.0, 0.4)]) * thick)]
    if rng.random() < 0.15:
        solids += bow(door, back + 0.5 * thick, front, rng.uniform(0.02, 0.08) * door.width)
    return solids


def pressed(rng: np.random.Generator, door: Rect, back: float, front: float, radius: float = 0.0) -> list[Mesh]:
    """A door of sheet: a skin with rims behind, its corners rounded by ``radius`` at most."""
    rim = max(rng.uniform(0.02, 0.08) * min(door.width, door.height), 0.003)
    skin = front - (front - back) * rng.uniform(0.15, 0.5)
    face = slab((door.x0, door.y0, skin), (door.x1, door.y1, front), 2, min(radius, rim))
    return [face, *frame((door.x0, door.y0, back), (door.x1, door.y1, skin), rim, rim)]


def bow(door: Rect, back: float, front: float, rise: float) -> list[Mesh]:
    """What makes a door's face bulge: its middle lies ``rise`` before its edges."""
    u = np.linspace(-1, 1, 9)
    line = zip(door.centre[0] + u * door.width / 2, front + rise * (1 - u**2), strict=True)
    return [column(x0, x1, back, z0, z1, door.y0, door.y1) for (x0, z0), (x1, z1) in pairwise(line)]


def _with_window(rng: np.random.Generator, door: Rect, back: float, front: float) -> list[Mesh]:
    thick, small = front - back, min(door.width, door.height)
    rims = rng.uniform(0.08, 0.3, 4) * small
    inner = Rect(door.x0 + rims[0], door.x1 - rims[1], door.y0 + rims[2], door.y1 - rims[3])
    pane = front - thick * rng.choice([rng.uniform(0.05, 0.2), rng.uniform(0.2, 0.9)])
    solids = [*surround(door, inner, back, front), inner.grown(1e-4).slab(pane - max(0.1 * thick, 0.001), pane)]
    if rng.random() < 0.25:  # a raised rim around the pane
        solids += surround(inner.grown(0.15 * rims.min()), inner, front - 0.002, front + rng.uniform(0.002, 0.008))
    return solids


def liner(rng: np.random.Generator, door: Rect, back: float, mouth: Rect, deepest: float) -> list[Mesh]:
    """What stands back from a door into the mouth, at most ``deepest``: a plug, or a rim, perhaps with bins. It leaves
    the walls room for the arc that its edge swings through, on whichever side the hinge is."""
    step = deepest * rng.uniform(0.15, 1.0)
    room = 0.004 + 0.6 * step**2 / min(door.width, door.height)
    field = mouth.grown(-max(room, rng.uniform(0.02, 0.1) * min(mouth.width, mouth.height)))
    if min(field.width, field.height) < 0.05:
        return []
    low, high = (field.x0, field.y0, back - step), (field.x1, field.y1, back + 0.001)
    if rng.random() < 0.5:
        return [slab(low, high, 2, rng.uniform(0.0, 0.03))]
    rim = rng.uniform(0.01, 0.04) * field.width
    solids = frame(low, high, rim, rim)
    if rng.random() < 0.5:
        for y in field.y0 + field.height * (np.arange(int(rng.integers(1, 5))) + 0.1) / 4:
            solids.append(box((field.x0 + rim, y, back - step), (field.x1 - rim, y + 0.02 * field.height, back)))
    return solids


def fixed_fronts(rng: np.random.Generator, opening: Rect) -> list[Mesh]:
    """What closes an opening in the front for good, if anything: a panel, or the fronts of drawers."""
    if rng.random() > 0.4:
        return []
    edges = np.linspace(opening.y0, opening.y1, rng.integers(2, 6))
    front, style, plain = rng.uniform(-0.004, 0.02), int(rng.integers(2**31)), rng.random() < 0.3
    solids = list[Mesh]()
    for low, high in pairwise(edges):
        face = replace(opening, y0=low, y1=high).grown(-0.0015)
        solids.append(face.slab(-0.012, front))
        if not plain and face.height > 0.05:
            solids += handle(np.random.default_rng(style), face, front, "top", 0.5)  # alike
    return solids
