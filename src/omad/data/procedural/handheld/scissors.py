"""Random scissors: office, kitchen, nail and embroidery; even and uneven loops, hooks and straight handles; and crude
ones of bars and rings."""

from copy import copy
from typing import Self

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import (
    JointedParts,
    Y,
    cylinder,
    ellipse,
    loft,
    points,
    rounded_rectangle,
    spline,
    squared,
    sweep,
    taper,
)


class _Blade:
    """One half, tip at +z, pivot at the origin, its back at +x and its handle at -x; metres."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.length = length = rng.uniform(0.025, 0.125)
        self.width = width = float(np.clip(length * rng.uniform(0.12, 0.32), 0.006, 0.024))
        """Of the blade near the pivot."""
        # nail and embroidery scissors have handles longer than their blades, shears the other way round
        self.handle_length = float(np.clip(length * rng.uniform(0.35, 1.3), 0.03, 0.085))
        self.inset = width * rng.uniform(0.05, 0.65)
        """How far the cutting edge lies beyond x = 0."""
        self.point = rng.uniform(0.03, 0.45)
        """Width of the tip as a share."""
        self.offset = rng.normal(0.0, 0.2)
        """Of the tip from x = 0, as a share of its width."""
        self.taper = rng.uniform(0.45, 1.3)
        """Exponent: below 1 the blade keeps its width till late."""
        self.curve = rng.normal(0.0, 0.06) * (rng.random() < 0.25)
        """Sideways bend of the tip out of its plane, as a share of the length."""
        self.thickness = rng.uniform(0.001, 0.0035)
        self.shank = length * (rng.uniform(0.12, 0.5) if rng.random() < 0.7 else rng.uniform(0.5, 0.9))
        """Distance from the pivot to the handle's beginning, along -z."""
        self.shank_width = width * rng.uniform(0.45, 1.0)
        self.handle = str(rng.choice(["loop"] * 10 + ["hook", "straight"]))
        self.handle_width = float(np.clip(self.handle_length * rng.uniform(0.4, 0.95), 0.02, 0.05))
        self.lean = rng.normal(0.12, 0.15)
        """Turn of the handle about y, radians."""
        self.egg = rng.uniform(-0.25, 0.25)
        """Above 0: wider in front."""
        self.flat = rng.uniform(0.0, 0.9) * (rng.random() < 0.6)
        """How straight the loop's inner side is, 0 to 1."""
        self.square = rng.uniform(1.9, 3.2)
        """Exponent of the loop's outline: 2 is an ellipse."""
        self.gap = rng.uniform(-0.003, 0.008)
        """From x = 0 to the handle's inner side, closed."""
        self.bar = rng.uniform(0.0025, 0.005) if rng.random() < 0.35 else rng.uniform(0.004, 0.011)
        """Width of the loop's bar."""
        self.bar_height = rng.uniform(0.003, 0.013)
        """Its thickness along y."""
        self.shoulder = rng.uniform(0.7, 1.3) if rng.random() < 0.5 else rng.uniform(1.3, 2.6)
        """Width of the shank's end in bars."""

    def partner(self, rng: np.random.Generator) -> Self:
        """The other half: the same, or with another handle and a slightly different blade."""
        if rng.random() < 0.45:
            return self
        other = copy(self)
        other.handle_length = float(np.clip(self.handle_length * rng.uniform(0.6, 1.5), 0.025, 0.1))
        other.length *= rng.uniform(0.95, 1.05)
        other.width *= rng.uniform(0.8, 1.2)
        other.point = rng.uniform(0.03, 0.6)
        other.handle = "loop" if rng.random() < 0.7 else self.handle
        other.handle_width = float(np.clip(self.handle_width * rng.uniform(0.7, 1.3), 0.018, 0.055))
        other.lean += rng.normal(0.0, 0.12)
        other.egg = rng.uniform(-0.25, 0.25)
        return other


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One pair, closed, the pivot at the origin."""
    if unusual:
        return _sized(unusual, *_of_bars(unusual))
    first = _Blade(rng)
    second = first.partner(rng)
    if rng.random() < 0.5:
        first, second = second, first
    level = (0.5 if rng.random() < 0.5 else -0.5) * (first.thickness + second.thickness) * rng.uniform(0.5, 1.0)
    base = _half(rng, first, -level)
    child = [solid.mirrored() for solid in _half(rng, second, level)]
    radius = rng.uniform(0.0014, max(0.3 * first.width, 0.002))
    reach = abs(level) + 0.5 * max(first.thickness, second.thickness) + rng.uniform(0.0002, 0.0025)
    if rng.random() < 0.85:
        (base if rng.random() < 0.5 else child).append(cylinder((0, -reach, 0), (0, reach, 0), radius, 14))
    return _sized(rng, base, child)


def _sized(rng: np.random.Generator, base: list[Mesh], child: list[Mesh]) -> JointedParts:
    """Both halves at a random real size."""
    parts = merge_meshes(base), merge_meshes(child)
    scale = rng.uniform(0.135, 0.25) / np.ptp(np.concatenate([part.vertices[:, 2] for part in parts]))
    return JointedParts(tuple(part.warped(lambda v: scale * v) for part in parts), np.zeros((1, 3)))


def _of_bars(rng: np.random.Generator) -> tuple[list[Mesh], list[Mesh]]:
    """Each half a bar, straight or bent at the pivot, that ends in a ring."""
    length, shank = rng.uniform(0.05, 0.12), rng.uniform(0.02, 0.07)
    width, thickness = rng.uniform(0.004, 0.014), rng.uniform(0.0015, 0.006)
    point, bend, turned = rng.uniform(0.15, 1.0), rng.uniform(0.0, 0.9), rng.choice([1, -1])
    round_bar, bar = rng.random() < 0.5, rng.uniform(0.002, 0.007)
    radius = rng.uniform(0.01, 0.024)
    halves = []
    for level in (-turned, turned):
        if rng.random() < 0.3:
            radius *= rng.uniform(0.75, 1.3)
        y = 0.5 * level * thickness
        outer = radius + 0.5 * bar + rng.uniform(0.0, 0.004)
        grip = np.array([-bend * outer, y, -shank])
        path = np.array([grip, 0.3 * grip, [0.0, y, 0.0], [0.0, y, 0.6 * length], [0.0, y, length]])
        path[:, 1] = y
        wide = width * np.array([1.0, 1.0, 1.0, 0.5 + 0.5 * point, point])
        blade = sweep(path, Y, taper(rounded_rectangle(1.0, 1.0, 0.05, 1), wide, thickness))
        beside = np.arcsin(min((outer + grip[0]) / radius, 1.0))
        centre = grip - radius * np.array([np.sin(beside), 0.0, np.cos(beside)])
        t = np.linspace(0.0, 2 * np.pi, 28, endpoint=False)
        loop = centre + radius * points(np.cos(t), 0.0, rng.uniform(1.0, 1.5) * np.sin(t))
        section = (
            ellipse(0.5 * bar, 0.5 * bar, 8) if round_bar else rounded_rectangle(bar, max(thickness, 0.003), 0.0, 1)
        )
        halves.append([blade, sweep(loop, Y, section, closed=True)])
    base, child = halves[0], [solid.mirrored() for solid in halves[1]]
    if rng.random() < 0.7:
        base.append(cylinder((0, -thickness - 0.001, 0), (0, thickness + 0.001, 0), 0.3 * width, 12))
    return base, child


def _half(rng: np.random.Generator, blade: _Blade, level: float) -> list[Mesh]:
    """Blade and shank around y = ``level``, the handle bent back to y = 0."""
    flat = 0.0 if rng.random() < 0.75 else level  # stamped metal ones stay in their plane
    handle, grip = _handle(blade, flat)
    return [_blade(blade, level), _shank(blade, level, flat, grip), handle]


def _blade(blade: _Blade, level: float) -> Mesh:
    """From a little behind the pivot to the tip: a straight cutting edge, a back that comes down to it."""
    u = np.concatenate([[-0.5 * blade.width / blade.length], np.linspace(0.0, 1.0, 16)])
    along = np.clip(u, 0, 1)
    width = blade.width * (blade.point + (1 - blade.point) * (1 - along ** (1 / blade.taper)))
    width[0] *= 0.7
    width[-1] *= 0.6
    edge = -blade.inset * (1 - along) - (0.5 - blade.offset) * width[-1] * along  # closed, the tips meet
    y = level + blade.curve * blade.length * along**2
    half = 0.5 * blade.thickness * (1 - 0.4 * along)
    corners = [(edge, y - half), (edge, y + half), (edge + width, y + half), (edge + width, y - half)]
    return loft(np.stack([points(x, height, u * blade.length) for x, height in corners], 1))


def _shank(blade: _Blade, level: float, flat: float, grip: np.ndarray) -> Mesh:
    """From the pivot across to the handle at ``grip`` (3,)."""
    start = [0.5 * blade.width - blade.inset, level, 0.25 * blade.width]
    middle = [0.25 * grip[0], level, 0.45 * grip[2]]
    bend = [0.75 * grip[0], 0.6 * flat + 0.4 * level, 0.8 * grip[2]]
    s, thin, thick = np.linspace(0.0, 1.0, 12), blade.thickness, max(blade.thickness, 0.9 * blade.bar_height)
    wide = np.interp(s, [0, 0.3, 1], [0.8 * blade.width, blade.shank_width, blade.shoulder * blade.bar])
    tall = np.interp(s, [0, 0.35, 0.7, 1], [thin, thin, thick, thick])
    section = taper(rounded_rectangle(1.0, 1.0, 0.25, 2), wide, tall)
    return sweep(spline([start, middle, bend, grip], 12), Y, section)


def _handle(blade: _Blade, y: float) -> tuple[Mesh, np.ndarray]:
    """The handle, and where the shank meets it (3,)."""
    a, b = 0.5 * blade.handle_width, 0.5 * blade.handle_length
    t = np.linspace(0.0, 2 * np.pi, 32, endpoint=False) + np.pi / 2  # begins at its front end
    x = a * squared(np.cos(t), 2 / blade.square) * (1 + blade.egg * np.sin(t))
    z = b * squared(np.sin(t), 2 / blade.square)
    x = np.where(x > 0, (1 - blade.flat) * x, x)
    cos, sin = np.cos(blade.lean), np.sin(blade.lean)
    x, z = cos * x + sin * z, cos * z - sin * x
    x, z = x - x.max() - 0.5 * blade.bar - blade.gap, z - z.max() - blade.shank
    loop = points(x, y, z)
    section = rounded_rectangle(blade.bar, blade.bar_height, 0.4 * min(blade.bar, blade.bar_height), 3)
    grip = loop[0]
    if blade.handle == "straight":
        middle, end = [0.8 * x.min(), y, 0.5 * (z.min() + grip[2])], [0.7 * x.min(), y, z.min()]
        wide = blade.bar * np.interp(np.linspace(0, 1, 14), [0, 0.5, 1], [1.0, 1.6, 1.2])
        return sweep(spline([grip, middle, end], 14), Y, taper(section, wide / blade.bar, 1.0)), grip
    if blade.handle == "hook":
        return sweep(loop[:22], Y, section), grip
    swell = 1 + 0.35 * blade.egg * np.cos(np.arange(32) * 2 * np.pi / 32)
    return sweep(loop, Y, taper(section, swell, 1.0), closed=True), grip
