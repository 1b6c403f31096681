"""Random things that are of no category: furniture, vessels, boxes, tools, household things; rigid, at real sizes.

What tells categories apart learns from them what an object of none looks like. y is up; lengths in metres.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.geometry.rigid import diagonal
from omad.objects.category import Category, JointSpec, PartSpec, ViewRange
from omad.objects.model import ObjectModel

from .shapes import Z, box, cylinder, ellipse, hexahedron, loft, points, sides, slab, spline, sweep

UNITS = (0.08, 0.25, 0.8)
"""Metres: sizes of the categories that strangers are put into, as noise and surroundings are relative to size."""


@dataclass(frozen=True)
class Strangers:
    """Those of about one size."""

    category: Category
    """As objects with parts and joints are posed and looked at, so are strangers: in two parts, one in the other, that
    stay where they are."""
    models: list[ObjectModel]


def strangers(count: int, seed: int = 0) -> list[Strangers]:
    """``count`` random ones in all; the same for the same arguments."""
    found = [Strangers(_category(unit), []) for unit in UNITS]
    for index in range(count):
        thing = stranger(np.random.default_rng([seed, index]))
        radius = diagonal(thing.vertices) / 2
        group = found[int(np.abs(np.log(np.array(UNITS) / radius)).argmin())]
        name, still = f"stranger-{seed}-{index:05d}", (np.eye(3)[1:2], np.zeros((1, 3)))
        group.models.append(ObjectModel.of(group.category, name, (thing, thing), *still).centred())
    return [group for group in found if group.models]


def _category(unit: float) -> Category:
    parts = PartSpec("thing", 1), PartSpec("again", 1)
    still = JointSpec("still", "prismatic", 0, (0.0, 1.0, 0.0), (0.0, 1e-6))
    return Category("stranger", unit, parts, (still,), ViewRange(azimuth=math.pi), basis_size=1)


def stranger(rng: np.random.Generator) -> Mesh:
    """One thing, its foot at y = 0."""
    return merge_meshes(KINDS[int(rng.integers(len(KINDS)))](rng))


def _plain_box(rng: np.random.Generator) -> list[Mesh]:
    x, y, z = np.exp(rng.uniform(np.log(0.03), np.log(0.6))) * rng.uniform(0.15, 1.0, 3)
    if rng.random() < 0.5:
        return [box((-x, 0, -z), (x, 2 * y, z))]
    return [slab((-x, 0, -z), (x, 2 * y, z), int(rng.integers(3)), rng.uniform(0.02, 0.9) * min(x, y, z))]


def _pile(rng: np.random.Generator) -> list[Mesh]:
    """Boxes, books or boards on each other."""
    size, low, made = np.exp(rng.uniform(np.log(0.08), np.log(0.5))), 0.0, []
    for _ in range(int(rng.integers(2, 6))):
        x, y, z = size * rng.uniform([0.5, 0.08, 0.4], [1.0, 0.5, 0.9])
        dx, dz = size * rng.uniform(-0.2, 0.2, 2)
        made.append(box((dx - x / 2, low, dz - z / 2), (dx + x / 2, low + y, dz + z / 2)))
        low += y
    return made


def _turned(rng: np.random.Generator) -> list[Mesh]:
    """A body of revolution: cup, bottle, vase, bowl, ball, bin, lamp shade; cups may have a handle."""
    height = np.exp(rng.uniform(np.log(0.05), np.log(0.5)))
    knots = int(rng.integers(2, 6))
    widest = height * rng.uniform(0.15, 0.9)
    radii = widest * rng.uniform(0.3, 1.0, knots)
    profile = spline(list(np.stack([np.linspace(0, height, knots), radii], 1)), 10)
    rings = [
        points(ring[:, 0], y, ring[:, 1])
        for y, r in profile
        for ring in [ellipse(max(r, 0.02 * height), max(r, 0.02 * height), 20)]
    ]
    made = [loft(np.stack(rings))]
    if rng.random() < 0.4:
        reach, middle, tall = (
            widest * rng.uniform(0.3, 0.9),
            height * rng.uniform(0.4, 0.6),
            height * rng.uniform(0.2, 0.35),
        )
        turn = np.linspace(-np.pi / 2, np.pi / 2, 10)
        side = float(np.interp(middle, profile[:, 0], profile[:, 1]))
        path = points(0.9 * side + reach * np.cos(turn), middle + tall * np.sin(turn), 0.0)
        made.append(sweep(path, Z, ellipse(*(height * rng.uniform(0.02, 0.07, 2)))))
    return made


def _legs(rng: np.random.Generator, x: float, z: float, high: float) -> list[Mesh]:
    thick, spread = high * rng.uniform(0.02, 0.06), rng.uniform(0.0, 0.15)
    corners = [(i, k) for i in (-1, 1) for k in (-1, 1)]
    at = [(i * (x - thick), k * (z - thick)) for i, k in corners]
    if rng.random() < 0.5:
        return [cylinder((a * (1 + spread), 0, b * (1 + spread)), (a, high, b), thick, 8) for a, b in at]
    return [box((a - thick, 0, b - thick), (a + thick, high, b + thick)) for a, b in at]


def _table(rng: np.random.Generator) -> list[Mesh]:
    x, high, z = rng.uniform([0.2, 0.3, 0.2], [0.9, 1.0, 0.5])
    thick = rng.uniform(0.01, 0.06)
    if rng.random() < 0.3:
        foot = [
            cylinder((0, 0, 0), (0, high, 0), rng.uniform(0.02, 0.06)),
            cylinder((0, 0, 0), (0, 0.02, 0), 0.7 * z, 20),
        ]
        return [*foot, cylinder((0, high, 0), (0, high + thick, 0), max(x, z) * 0.7, 24)]
    made = [*_legs(rng, x, z, high), box((-x, high, -z), (x, high + thick, z))]
    if rng.random() < 0.3:
        level = high * rng.uniform(0.15, 0.6)
        made.append(box((-0.9 * x, level, -0.9 * z), (0.9 * x, level + thick, 0.9 * z)))
    return made


def _chair(rng: np.random.Generator) -> list[Mesh]:
    x, seat, z = rng.uniform([0.18, 0.3, 0.18], [0.35, 0.55, 0.32])
    thick, back, lean = rng.uniform(0.015, 0.12), rng.uniform(0.25, 0.6), rng.uniform(0.0, 0.2)
    made = [slab((-x, seat, -z), (x, seat + thick, z), 1, rng.uniform(0.0, 0.1))]
    made += _legs(rng, x, z, seat) if rng.random() < 0.7 else [box((-x, 0, -z), (x, seat, z))]
    panel = points([-x, x, x, -x], 0.0, [-z, -z, -z + 0.03, -z + 0.03])
    low, high = seat + thick + back * rng.uniform(0.0, 0.5), seat + thick + back
    rise = np.array([[0, y, -lean * (y - seat)] for y in (low, high)])
    made.append(hexahedron(np.concatenate([panel + rise[0], panel + rise[1]])))
    if low > seat + 0.06:
        made += [
            cylinder((s * 0.9 * x, seat, -z), (s * 0.9 * x, low, -z - lean * (low - seat)), 0.012) for s in (-1, 1)
        ]
    if rng.random() < 0.4:
        arm = seat + rng.uniform(0.12, 0.25)
        made += [box((s * x - 0.02, arm - 0.03, -z), (s * x + 0.02, arm, 0.8 * z)) for s in (-1, 1)]
        made += [box((s * x - 0.02, seat, 0.7 * z), (s * x + 0.02, arm, 0.8 * z)) for s in (-1, 1)]
    return made


def _open_shelf(rng: np.random.Generator) -> list[Mesh]:
    x, high, z = rng.uniform([0.15, 0.3, 0.1], [0.6, 2.0, 0.25])
    wall = rng.uniform(0.01, 0.03)
    made = [*sides((-x, 0, -z), (x, high, z), wall), box((-x, high - wall, -z), (x, high, z))]
    made += [box((-x, y, -z), (x, y + wall, z)) for y in np.linspace(0, high - 2 * wall, int(rng.integers(2, 7)))[:-1]]
    return made + ([box((-x, 0, -z), (x, high, wall - z))] if rng.random() < 0.7 else [])


def _screen_on_foot(rng: np.random.Generator) -> list[Mesh]:
    """A monitor, a picture frame, a road sign: a panel that one post carries."""
    x, y = rng.uniform([0.08, 0.06], [0.6, 0.4])
    high, thick, base = y * rng.uniform(0.2, 2.0), rng.uniform(0.01, 0.06), x * rng.uniform(0.25, 0.7)
    panel = slab((-x, high, -thick / 2), (x, high + 2 * y, thick / 2), 2, rng.uniform(0.0, 0.2) * y)
    post = cylinder((0, 0, -thick / 2), (0, high + y, -thick / 2), rng.uniform(0.1, 0.5) * thick + 0.004)
    return [panel, post, slab((-base, 0, -base * 0.7), (base, thick / 2, base * 0.7), 1, base * rng.uniform(0, 0.6))]


def _bars(rng: np.random.Generator) -> list[Mesh]:
    """A tool: a handle and a head, or sticks that lie across each other."""
    long = np.exp(rng.uniform(np.log(0.08), np.log(0.6)))
    thick = long * rng.uniform(0.015, 0.08)
    made = [cylinder((-long / 2, thick, 0), (long / 2, thick, 0), thick, 10)]
    if rng.random() < 0.6:
        head = long * rng.uniform([0.03, 0.04, 0.1], [0.15, 0.12, 0.4])
        made.append(
            slab(
                (long / 2 - head[0], thick - head[1] / 2, -head[2]),
                (long / 2 + head[0], thick + head[1] / 2, head[2] * rng.uniform(0.2, 1.0)),
                int(rng.integers(3)),
                0.3 * head.min(),
            )
        )
    for _ in range(int(rng.integers(0, 3))):
        angle, middle = rng.uniform(0.2, np.pi - 0.2), long * rng.uniform(-0.4, 0.4)
        half = 0.5 * long * rng.uniform(0.2, 1.0) * np.array([np.cos(angle), 0, np.sin(angle)])
        made.append(
            cylinder(
                np.array([middle, 2.5 * thick, 0]) - half,
                np.array([middle, 2.5 * thick, 0]) + half,
                thick * rng.uniform(0.4, 1.0),
                8,
            )
        )
    return made


def _blob(rng: np.random.Generator) -> list[Mesh]:
    """A toy, a fruit, a cushion: one to four rounded lumps."""
    size, made = np.exp(rng.uniform(np.log(0.04), np.log(0.4))), []
    for _ in range(int(rng.integers(1, 5))):
        radii, place = size * rng.uniform(0.2, 0.6, 3), size * rng.uniform(-0.4, 0.4, 3)
        levels = np.linspace(-0.5, 0.5, 9)[1:-1] * np.pi
        outline = ellipse(1.0, 1.0, 14)
        rings = [points(outline[:, 0] * np.cos(a), np.sin(a), outline[:, 1] * np.cos(a)) * radii for a in levels]
        made.append(loft(np.stack(rings) + place + [0, size, 0]))
    return made


KINDS: tuple[Callable[[np.random.Generator], list[Mesh]], ...] = (
    _plain_box, _pile, _turned, _turned, _table, _chair, _chair, _open_shelf, _screen_on_foot, _bars, _blob,
)  # fmt: skip
