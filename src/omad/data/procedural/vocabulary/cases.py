"""Bodies with a cavity that is open to the front."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from omad.geometry.mesh import Mesh

from ..shapes import box, cylinder, hexahedron, loft


@dataclass(frozen=True)
class Rect:
    """A rectangle in a plane of constant z, metres."""

    x0: float
    x1: float
    y0: float
    y1: float

    @property
    def width(self) -> float:
        return self.x1 - self.x0

    @property
    def height(self) -> float:
        return self.y1 - self.y0

    @property
    def centre(self) -> np.ndarray:
        """(2,)."""
        return np.array([self.x0 + self.x1, self.y0 + self.y1]) / 2

    def grown(self, x: float, y: float | None = None) -> "Rect":
        """Its sides moved outwards, by ``x`` left and right and by ``y``, or as far, below and above."""
        y = x if y is None else y
        return Rect(self.x0 - x, self.x1 + x, self.y0 - y, self.y1 + y)

    def mirrored(self) -> "Rect":
        """In the plane x = 0."""
        return Rect(-self.x1, -self.x0, self.y0, self.y1)

    def slab(self, back: float, front: float) -> Mesh:
        """The box over it between two planes."""
        return box((self.x0, self.y0, back), (self.x1, self.y1, front))

    def arched(self, radius: float, right: bool = True) -> np.ndarray:
        """Its outline (n, 2), counter-clockwise, the upper corners, or the left one alone, rounded."""
        turns = np.linspace(0.0, np.pi / 2, 7)
        corner = radius * np.stack([np.cos(turns), np.sin(turns)], 1)
        top_left = [self.x0 + radius, self.y1 - radius] + corner[::-1] * [-1, 1]
        top_right = [self.x1 - radius, self.y1 - radius] + corner if right else [[self.x1, self.y1]]
        return np.concatenate([[[self.x0, self.y0], [self.x1, self.y0]], top_right, top_left])


@dataclass(frozen=True)
class Case:
    """A body over x = -width / 2 .. width / 2, y = foot .. height, z = -depth .. 0, whose walls are so thick. Raises
    ValueError where they leave no cavity."""

    width: float
    height: float
    depth: float
    left: float
    right: float
    bottom: float
    top: float
    back: float
    foot: float = 0.0

    def __post_init__(self) -> None:
        if min(self.mouth.width, self.mouth.height, self.depth - self.back) <= 0:
            raise ValueError("the walls of the case leave no cavity; make them thinner, or the case larger")

    @property
    def front(self) -> Rect:
        """All that is seen of it from the front."""
        return Rect(-self.width / 2, self.width / 2, self.foot, self.height)

    @property
    def mouth(self) -> Rect:
        """Where it is open."""
        front = self.front
        return Rect(front.x0 + self.left, front.x1 - self.right, front.y0 + self.bottom, front.y1 - self.top)

    def walls(self) -> list[Mesh]:
        """Five."""
        front, mouth = self.front, self.mouth
        return [
            box((front.x0, front.y0, -self.depth), (mouth.x0, front.y1, 0)),
            box((mouth.x1, front.y0, -self.depth), (front.x1, front.y1, 0)),
            box((mouth.x0, front.y0, -self.depth), (mouth.x1, mouth.y0, 0)),
            box((mouth.x0, mouth.y1, -self.depth), (mouth.x1, front.y1, 0)),
            mouth.slab(-self.depth, -self.depth + self.back),
        ]

    def sheet(self, skin: float) -> list[Mesh]:
        """The same outside and the same mouth, all of sheet so thick, or as thin as its thinnest wall: its cavity is as
        large as it is, as no tub is in it."""
        skin = min(skin, self.left, self.right, self.bottom, self.top, self.back)
        thin = replace(self, left=skin, right=skin, bottom=skin, top=skin, back=skin)
        return [*thin.walls(), *surround(thin.mouth, self.mouth, -skin, 0.0)]

    def arched_walls(self, radius: float) -> list[Mesh]:
        """Those of a case whose upper corners are rounded by so much, and its mouth's with them."""
        outer, inner = self.front.arched(radius), self.mouth.arched(max(radius - self.top, 1e-3))
        quads = np.stack([outer, np.roll(outer, -1, 0), np.roll(inner, -1, 0), inner], 1)
        ends = np.insert(quads, 2, -self.depth, 2), np.insert(quads, 2, 0.0, 2)
        back = [np.insert(inner, 2, z, 1) for z in (-self.depth, -self.depth + self.back)]
        return [*map(hexahedron, np.concatenate(ends, 1)), loft(np.stack(back))]


def shelves(rng: np.random.Generator, case: Case, most: int, gap: float = 0.0) -> list[Mesh]:
    """Up to ``most`` boards across the cavity, which end ``gap`` or more behind its mouth."""
    mouth, count = case.mouth, int(rng.integers(0, most + 1))
    thick = min(rng.uniform(0.004, 0.025), 0.05 * mouth.height)
    back, front = -case.depth + case.back, -gap - rng.choice([0.003, rng.uniform(0.0, 0.3)]) * (case.depth - case.back)
    if front - back < 0.1 * case.depth:
        return []
    jitter = rng.uniform(-0.25, 0.25) if rng.random() < 0.5 else 0.0
    heights = mouth.y0 + mouth.height * (np.arange(1, count + 1) + jitter) / (count + 1)
    return [box((mouth.x0, y - thick / 2, back), (mouth.x1, y + thick / 2, front)) for y in heights]


def surround(outer: Rect, inner: Rect, back: float, front: float) -> list[Mesh]:
    """A frame between two rectangles and two planes: what a door that is let into the front lies between. Sides that
    are thinner than half a millimetre are left out."""
    sides = (
        Rect(outer.x0, inner.x0, outer.y0, outer.y1),
        Rect(inner.x1, outer.x1, outer.y0, outer.y1),
        Rect(inner.x0, inner.x1, outer.y0, inner.y0),
        Rect(inner.x0, inner.x1, inner.y1, outer.y1),
    )
    return [side.slab(back, front) for side in sides if min(side.width, side.height) > 5e-4]


def controls(rng: np.random.Generator, rect: Rect, front: float, most: int = 5) -> list[Mesh]:
    """A display, and up to ``most`` buttons or knobs in a row along the longer side of ``rect``."""
    count, small = int(rng.integers(0, most + 1)), 0.5 * min(rect.width, rect.height)
    upright = rect.height > rect.width
    long = max(rect.width, rect.height)
    solids: list[Mesh] = []
    if rng.random() < 0.5:
        half = (0.7 * small, rng.uniform(0.1, 0.16) * long)[:: 1 if upright else -1]
        at = rect.centre + np.array([0.0, 0.36 * long] if upright else [rng.choice([0.0, 0.33]) * long, 0.0])
        solids.append(_on(at, half, front, rng.uniform(0.001, 0.004)))
    size, reach, round_ = small * rng.uniform(0.25, 0.6), rng.uniform(0.002, 0.025), rng.random() < 0.6
    places = np.linspace(-0.4, rng.uniform(0.15, 0.4), count + 2)[1:-1] * long
    size = min(size, 0.3 * long / (count + 1))
    for place in places:
        at = rect.centre + np.array([0.0, place] if upright else [place, 0.0])
        if round_:
            solids.append(cylinder((*at, front - 0.003), (*at, front + reach), size, 12))
        else:
            solids.append(_on(at, (size, size), front, 0.3 * reach))
    return solids


def _on(at: np.ndarray, half: Iterable[float], front: float, reach: float) -> Mesh:
    x, y = half
    return Rect(at[0] - x, at[0] + x, at[1] - y, at[1] + y).slab(front - 0.003, front + reach)
