"""Handles: bars, arches, ledges, knobs, pockets."""

import numpy as np

from omad.geometry.mesh import Mesh

from ..shapes import box, cylinder, points, posts, slab, tube
from .cases import Rect

TURNS = {"top": (1, 0), "bottom": (-1, 0), "right": (0, 1), "left": (0, -1)}
"""Cosine and sine of the turn, clockwise, that takes a face's top edge there."""


def handle_across(rng: np.random.Generator, half: float, low: float, high: float, front: float) -> list[Mesh]:
    """A handle near the upper edge of a face over x = -half .. half, y = low .. high, z = front: a bar on two posts,
    round or flat; an arch; a ledge; a knob; a raised frame around a pocket."""
    y = high - (high - low) * rng.uniform(0.04, 0.22)
    reach, grip = rng.uniform(0.02, 0.07), rng.uniform(0.006, 0.02)
    span, root, tip = half * rng.uniform(0.3, 0.95), front - 0.003, front + reach
    kind = rng.random()
    if kind < 0.5:
        held, end = posts(0.0, y, span, grip, root, tip), span + grip
        if rng.random() < 0.5:
            return [*held, cylinder((-end, y, tip), (end, y, tip), grip)]
        return [*held, slab((-end, y - 1.5 * grip, tip - grip), (end, y + 1.5 * grip, tip + 0.5 * grip), 2, grip)]
    if kind < 0.65:  # an arch, bowed towards the room and sometimes up or down
        s = np.linspace(-1, 1, 9)
        rise = 1 - np.abs(s) ** rng.uniform(2.0, 8.0)
        drop = (high - y) * rng.uniform(-0.5, 0.5) * (rng.random() < 0.4)
        return [tube(points(s * span, y + drop * rise, root + reach * rise), grip)]
    if kind < 0.78:
        return [box((-span, y - grip, root), (span, y + grip, front + 0.6 * reach))]
    if kind < 0.87:
        return [cylinder((0, y, root), (0, y, tip), 1.5 * grip)]
    tall, rim = rng.uniform(0.02, 0.05), 0.4 * grip
    ledges = (y + tall, y + tall + rim), (y - tall - rim, y - tall)
    return [box((-span, a, root), (span, b, front + 0.3 * reach)) for a, b in ledges]


def handle(rng: np.random.Generator, face: Rect, front: float, edge: str = "top", size: float = 1.0) -> list[Mesh]:
    """A handle near one ``edge`` of a face, "top", "bottom", "right" or "left", and along it; ``size`` shrinks it in
    thickness and reach, not in length. Raises ValueError for another edge."""
    if edge not in TURNS:
        raise ValueError(f"edge: is {edge!r}; give {', '.join(TURNS)}")
    long, wide = (face.width, face.height) if edge in ("top", "bottom") else (face.height, face.width)
    made = handle_across(rng, long / 2 / size, 0.0, wide / size, 0.0)
    turn, (cx, cy), s = TURNS[edge], face.centre, size

    def place(vertices: np.ndarray) -> np.ndarray:
        x, y, z = s * vertices.T
        y = y - wide / 2
        return points(cx + turn[0] * x + turn[1] * y, cy + turn[0] * y - turn[1] * x, front + z)

    return [solid.warped(place) for solid in made]


class Pull:
    """The kind of handle that all drawers of a chest have."""

    def __init__(self, rng: np.random.Generator, unusual: np.random.Generator | None) -> None:
        self.kind = rng.random()
        self.pair = rng.random() < 0.35
        self.size, self.reach = rng.uniform(0.008, 0.02), rng.uniform(0.015, 0.05)
        self.span, self.height = rng.uniform(0.1, 0.45), rng.uniform(0.3, 0.85)
        self.bevel = rng.uniform(0.0, 0.004)
        if unusual:  # a bar, or a ledge, across nearly all of the face
            self.kind, self.pair = unusual.uniform(0.4, 0.9), False
            self.span, self.reach = unusual.uniform(0.5, 0.97), unusual.uniform(0.02, 0.08)
            self.size *= unusual.uniform(1.0, 2.0)

    def solids(self, half: float, low: float, high: float, front: float) -> list[Mesh]:
        """Handles on a face that spans x = -half .. half, y = low .. high at z = front."""
        if self.kind < 0.12:
            return []  # pushed open, or gripped at its edge
        y, root = low + self.height * (high - low), front - 0.002
        centres = (-0.5 * half, 0.5 * half) if self.pair and half > 0.25 else (0.0,)
        solids = []
        span, tip, g = self.span * half / len(centres), front + self.reach, 0.5 * self.size
        for x in centres:
            if self.kind < 0.4:
                solids.append(cylinder((x, y, root), (x, y, tip), self.size, 12))
            elif self.kind < 0.8:
                solids += posts(x, y, span, g, root, tip)
                solids.append(slab((x - span - g, y - g, tip - g), (x + span + g, y + g, tip + g), 2, 0.4 * g))
            elif self.kind < 0.9:
                solids.append(box((x - span, y - g, root), (x + span, y + g, front + 0.6 * self.reach)))
            else:
                lip = half * 0.98 / len(centres)
                solids.append(box((x - lip, high - 1.5 * g, root), (x + lip, high, front + 0.5 * self.reach)))
        return solids
