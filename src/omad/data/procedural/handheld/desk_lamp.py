"""Random desk lamps: a foot, two arms and a head, jointed one on the other."""

from dataclasses import dataclass

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder, loft, slab
from ..vocabulary.vessels import turned


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One lamp at rest: the lower arm upright, the upper one level to the front, the head hanging down. Its foot stands
    on y = 0, all of its joints are in the plane x = 0."""
    high = rng.uniform(0.17, 0.36)
    low = high * rng.uniform(1.0, 1.6)
    bar = rng.uniform(0.003, 0.011)
    joint = _Joint(bar, bar * rng.uniform(0.8, 1.6))
    forked = rng.random() < 0.5  # whether the lower arm is of two rods, and the upper one of one
    foot, top = _foot(rng, low + high, bar)
    first = np.array([0.0, top + 1.6 * joint.radius, rng.choice([0.0, rng.uniform(-0.03, 0.01)])])
    second, third = first + [0, low, 0], first + [0, low, high]
    foot += joint.tongue(not forked, first, top - 0.004)
    lower = joint.arm(rng, forked, first, second)
    upper = joint.arm(rng, not forked, second, third)
    if rng.random() < 0.3:  # a counterweight behind
        behind = second - [0, 0, rng.uniform(0.03, 0.08) + joint.radius]
        upper += joint.rods(not forked, second, behind)
        upper.append(cylinder(behind, behind - [0, 0, rng.uniform(0.02, 0.05)], rng.uniform(2.0, 3.0) * bar, 12))
    parts = foot, lower, upper, _head(rng, joint, forked, third, high)
    return JointedParts(tuple(map(merge_meshes, parts)), np.stack([first, second, third]))


@dataclass(frozen=True)
class _Joint:
    """Knuckles between neighbours, of which one is forked and holds the other."""

    bar: float
    """Thickness of the rods."""
    radius: float
    """Of the knuckles."""

    def places(self, forked: bool) -> tuple[float, ...]:
        """Of rods along x."""
        return (-1.25 * self.bar, 1.25 * self.bar) if forked else (0.0,)

    def knuckle(self, forked: bool, at: np.ndarray) -> list[Mesh]:
        """Discs about the joint's axis, with a pin in a fork."""
        half = np.array([0.52 * self.bar, 0.0, 0.0])
        discs = [cylinder(at + [x, 0, 0] - half, at + [x, 0, 0] + half, self.radius, 12) for x in self.places(forked)]
        pin = np.array([1.3 * self.bar, 0.0, 0.0])
        return [*discs, cylinder(at - pin, at + pin, 0.25 * self.bar, 6)] if forked else discs

    def rods(self, forked: bool, start: np.ndarray, end: np.ndarray) -> list[Mesh]:
        return [cylinder(start + [x, 0, 0], end + [x, 0, 0], 0.5 * self.bar, 8) for x in self.places(forked)]

    def tongue(self, forked: bool, at: np.ndarray, y: float) -> list[Mesh]:
        """A knuckle, and what carries it from the height ``y``, above or below."""
        low, high = sorted((y, float(at[1])))
        half, wide = 0.52 * self.bar, 0.8 * self.radius
        carriers = [box((x - half, low, at[2] - wide), (x + half, high, at[2] + wide)) for x in self.places(forked)]
        end = min(y, y + 0.3 * self.radius * np.sign(at[1] - y)), max(y, y + 0.3 * self.radius * np.sign(at[1] - y))
        across = box((-1.8 * self.bar, end[0], at[2] - wide), (1.8 * self.bar, end[1], at[2] + wide))
        return [*self.knuckle(forked, at), *carriers, across]

    def arm(self, rng: np.random.Generator, forked: bool, start: np.ndarray, end: np.ndarray) -> list[Mesh]:
        """Rods between two knuckles, round or in a case, with a spring sometimes."""
        solids = [*self.knuckle(forked, start), *self.knuckle(forked, end), *self.rods(forked, start, end)]
        along = (end - start) / np.linalg.norm(end - start)
        lift = np.cross([1.0, 0, 0], along)  # across the arm, in the plane of the lamp
        near, far = start + 2.5 * self.radius * along, end - 2.5 * self.radius * along
        if rng.random() < 0.3:
            wide, tall = 1.9 * self.bar, rng.uniform(0.6, 1.4) * self.bar
            corner = np.array([[-wide, -tall], [wide, -tall], [wide, tall], [-wide, tall]])
            ring = corner[:, :1] * [1.0, 0, 0] + corner[:, 1:] * lift
            solids.append(loft(np.stack([near + ring, far + ring])))
        elif rng.random() < 0.3:
            shift = 1.3 * self.bar * lift
            solids.append(cylinder(near + shift, near + 0.5 * (far - near) + shift, 0.5 * self.bar, 8))
        return solids


def _foot(rng: np.random.Generator, tall: float, bar: float) -> tuple[list[Mesh], float]:
    """A disc, a slab or a clamp, perhaps with a post on it, and how high it is."""
    size, thick = tall * rng.uniform(0.1, 0.2), rng.uniform(0.008, 0.04)
    kind, post = rng.random(), rng.choice([0.0, rng.uniform(0.01, 0.06)])
    if kind < 0.6:
        edge = rng.uniform(0.4, 1.0)
        solids = [turned([(size, 0.0), (size, 0.5 * thick), (edge * size, thick)])]
    elif kind < 0.85:
        wide, corner = size * rng.uniform(0.7, 1.0), rng.uniform(0.0, 0.04)
        solids = [slab((-wide, 0, -size), (wide, thick, size), 1, corner, 0.2 * thick)]
    else:  # clamped to a table's edge
        jaw, thick = rng.uniform(0.02, 0.035), rng.uniform(0.05, 0.09)
        solids = [box((-jaw, thick - 0.012, -0.03), (jaw, thick, 0.05)), box((-jaw, 0.012, -0.03), (jaw, 0.024, 0.05))]
        solids += [box((-jaw, 0.012, -0.042), (jaw, thick, -0.03)), cylinder((0, 0, 0.02), (0, 0.02, 0.02), 0.012)]
    if post:
        solids.append(cylinder((0, thick - 0.002, 0), (0, thick + post, 0), bar * rng.uniform(1.0, 2.0), 12))
    return solids, thick + post


def _head(rng: np.random.Generator, joint: _Joint, forked: bool, at: np.ndarray, high: float) -> list[Mesh]:
    """A shade like a bell or a can that opens downwards, or a flat bar of lights that hangs down."""
    drop = 1.6 * joint.radius + rng.uniform(0.0, 0.02)
    neck = joint.tongue(forked, at, at[1] - drop - 0.004)
    if rng.random() < 0.35:
        half, long, thick = rng.uniform(0.012, 0.05), rng.uniform(0.06, 0.2), rng.uniform(0.006, 0.02)
        low = at + [-half, -drop - long, -0.5 * thick]
        return [*neck, slab(low, at + [half, -drop, 0.5 * thick], 2, rng.uniform(0.0, 0.02), 0.2 * thick)]
    radius, tall = high * rng.uniform(0.14, 0.3), high * rng.uniform(0.2, 0.4)
    cap, wall, s = radius * rng.uniform(0.3, 0.7), 0.002, np.linspace(0.0, 1.0, 6)
    flare = cap + (radius - cap) * s ** rng.uniform(0.4, 2.2)
    outside = [(r, -tall * t) for r, t in zip(flare, s, strict=True)]
    inside = [(r - wall, -tall * t - wall * (t == 0)) for r, t in zip(flare[::-1], s[::-1], strict=True)]
    shade = turned([*outside, *inside], 20).warped(lambda v: v + at - [0, drop, 0])
    bulb = turned([(0.008, -0.002), (0.02, -0.4 * tall), (0.026, -0.6 * tall), (0.012, -0.8 * tall)], 12)
    bulbs = [bulb.warped(lambda v: v + at - [0, drop, 0])] if cap > 0.022 and rng.random() < 0.6 else []
    return [*neck, shade, *bulbs]
