"""Random scissors: office, kitchen, nail and embroidery; even and uneven loops, hooks and straight handles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...categories import SCISSORS
from ...objects import Mesh, ObjectModel
from .shapes import cylinder, loft, merge, rounded_rectangle, spline, sweep, warp


@dataclass(frozen=True)
class _Blade:
    """One half, tip at +z, pivot at the origin, its back at +x and its handle at -x; metres."""

    length: float
    width: float
    """Of the blade near the pivot."""
    inset: float
    """How far the cutting edge lies beyond x = 0."""
    point: float
    """Width of the tip as a share."""
    offset: float
    """Of the tip from x = 0, as a share of its width."""
    taper: float
    """Exponent: below 1 the blade keeps its width till late."""
    curve: float
    """Sideways bend of the tip out of its plane, as a share of the length."""
    thickness: float
    shank: float
    """Distance from the pivot to the handle's beginning, along -z."""
    shank_width: float
    handle: str
    handle_length: float
    handle_width: float
    lean: float
    """Turn of the handle about y, radians."""
    egg: float
    """Above 0: wider in front."""
    flat: float
    """How straight the loop's inner side is, 0 to 1."""
    square: float
    """Exponent of the loop's outline: 2 is an ellipse."""
    gap: float
    """From x = 0 to the handle's inner side, closed."""
    bar: float
    """Width of the loop's bar."""
    bar_height: float
    """Its thickness along y."""
    shoulder: float
    """Width of the shank's end in bars."""


def scissors(rng: np.random.Generator, name: str) -> ObjectModel:
    """One pair, closed, the pivot at the origin."""
    first = _draw(rng)
    second = _partner(rng, first)
    if rng.random() < 0.5:
        first, second = second, first
    level = (0.5 if rng.random() < 0.5 else -0.5) * (first.thickness + second.thickness) * rng.uniform(0.5, 1.0)
    base = _half(rng, first, -level)
    child = [_mirrored(solid) for solid in _half(rng, second, level)]
    radius = rng.uniform(0.0014, max(0.3 * first.width, 0.002))
    reach = abs(level) + 0.5 * max(first.thickness, second.thickness) + rng.uniform(0.0002, 0.0025)
    if rng.random() < 0.85:
        (base if rng.random() < 0.5 else child).append(cylinder((0, -reach, 0), (0, reach, 0), radius, 14))
    parts = merge(base), merge(child)
    scale = rng.uniform(0.135, 0.25) / np.ptp(np.concatenate([part.vertices[:, 2] for part in parts]))
    return ObjectModel(
        name=name,
        category=SCISSORS.name,
        part_names=tuple(part.name for part in SCISSORS.parts),
        parts=tuple(warp(part, lambda v: scale * v) for part in parts),
        joint_names=tuple(joint.name for joint in SCISSORS.joints),
        tree=SCISSORS.tree,
        axes=np.array([[0.0, 1.0, 0.0]]),
        pivots=np.zeros((1, 3)),
        limits=np.array([joint.limits for joint in SCISSORS.joints]),
    ).centred()


def _draw(rng: np.random.Generator) -> _Blade:
    length = rng.uniform(0.025, 0.125)
    width = float(np.clip(length * rng.uniform(0.12, 0.32), 0.006, 0.024))
    # nail and embroidery scissors have handles longer than their blades, shears the other way round
    handle_length = float(np.clip(length * rng.uniform(0.35, 1.3), 0.03, 0.085))
    return _Blade(
        length=length,
        width=width,
        inset=width * rng.uniform(0.05, 0.65),
        point=rng.uniform(0.03, 0.45),
        offset=rng.normal(0.0, 0.2),
        taper=rng.uniform(0.45, 1.3),
        curve=rng.normal(0.0, 0.06) * (rng.random() < 0.25),
        thickness=rng.uniform(0.001, 0.0035),
        shank=length * rng.uniform(0.12, 0.5) if rng.random() < 0.7 else length * rng.uniform(0.5, 0.9),
        shank_width=width * rng.uniform(0.45, 1.0),
        handle=str(rng.choice(["loop"] * 10 + ["hook", "straight"])),
        handle_length=handle_length,
        handle_width=float(np.clip(handle_length * rng.uniform(0.4, 0.95), 0.02, 0.05)),
        lean=rng.normal(0.12, 0.15),
        egg=rng.uniform(-0.25, 0.25),
        flat=rng.uniform(0.0, 0.9) * (rng.random() < 0.6),
        square=rng.uniform(1.9, 3.2),
        gap=rng.uniform(-0.003, 0.008),
        bar=rng.uniform(0.0025, 0.005) if rng.random() < 0.35 else rng.uniform(0.004, 0.011),
        bar_height=rng.uniform(0.003, 0.013),
        shoulder=rng.uniform(0.7, 1.3) if rng.random() < 0.5 else rng.uniform(1.3, 2.6),
    )


def _partner(rng: np.random.Generator, blade: _Blade) -> _Blade:
    """The other half: the same, or with another handle and a slightly different blade."""
    if rng.random() < 0.45:
        return blade
    handle_length = float(np.clip(blade.handle_length * rng.uniform(0.6, 1.5), 0.025, 0.1))
    return replace(
        blade,
        length=blade.length * rng.uniform(0.95, 1.05),
        width=blade.width * rng.uniform(0.8, 1.2),
        point=rng.uniform(0.03, 0.6),
        handle="loop" if rng.random() < 0.7 else blade.handle,
        handle_length=handle_length,
        handle_width=float(np.clip(blade.handle_width * rng.uniform(0.7, 1.3), 0.018, 0.055)),
        lean=blade.lean + rng.normal(0.0, 0.12),
        egg=rng.uniform(-0.25, 0.25),
    )


def _half(rng: np.random.Generator, blade: _Blade, level: float) -> list[Mesh]:
    """Blade and shank around y = ``level``, the handle bent back to y = 0."""
    flat = 0.0 if rng.random() < 0.75 else level  # stamped metal ones stay in their plane
    handle, grip = _handle(blade, flat)
    return [_blade(blade, level), _shank(blade, level, flat, grip), *handle]


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
    z = u * blade.length
    corners = [(edge, y - half), (edge, y + half), (edge + width, y + half), (edge + width, y - half)]
    return loft(np.stack([np.stack([x, height, z], 1) for x, height in corners], 1))


def _shank(blade: _Blade, level: float, flat: float, grip: np.ndarray) -> Mesh:
    """From the pivot across to the handle at ``grip`` (3,)."""
    start = np.array([0.5 * blade.width - blade.inset, level, 0.25 * blade.width])
    middle = np.array([0.25 * grip[0], level, 0.45 * grip[2]])
    bend = np.array([0.75 * grip[0], 0.6 * flat + 0.4 * level, 0.8 * grip[2]])
    path = spline([start, middle, bend, grip], 12)
    s = np.linspace(0.0, 1.0, 12)
    wide = np.interp(s, [0, 0.3, 1], [0.8 * blade.width, blade.shank_width, blade.shoulder * blade.bar])
    tall = np.interp(
        s, [0, 0.35, 0.7, 1], [*2 * [blade.thickness], *2 * [max(blade.thickness, 0.9 * blade.bar_height)]]
    )
    outline = rounded_rectangle(1.0, 1.0, 0.25, 2)
    return sweep(path, np.array([0.0, 1.0, 0.0]), outline * np.stack([wide, tall], 1)[:, None])


def _handle(blade: _Blade, y: float) -> tuple[list[Mesh], np.ndarray]:
    """The handle's solids, and where the shank meets it (3,)."""
    a, b = 0.5 * blade.handle_width, 0.5 * blade.handle_length
    t = np.linspace(0.0, 2 * np.pi, 32, endpoint=False) + np.pi / 2  # begins at its front end
    x = a * np.sign(np.cos(t)) * np.abs(np.cos(t)) ** (2 / blade.square) * (1 + blade.egg * np.sin(t))
    z = b * np.sign(np.sin(t)) * np.abs(np.sin(t)) ** (2 / blade.square)
    x = np.where(x > 0, (1 - blade.flat) * x, x)
    cos, sin = np.cos(blade.lean), np.sin(blade.lean)
    x, z = cos * x + sin * z, cos * z - sin * x
    x, z = x - x.max() - 0.5 * blade.bar - blade.gap, z - z.max() - blade.shank
    loop = np.stack([x, np.full(len(x), y), z], 1)
    up = np.array([0.0, 1.0, 0.0])
    section = rounded_rectangle(blade.bar, blade.bar_height, 0.4 * min(blade.bar, blade.bar_height), 3)
    grip = loop[0]
    if blade.handle == "straight":
        end = np.array([0.7 * x.min(), y, z.min()])
        middle = np.array([0.8 * x.min(), y, 0.5 * (z.min() + grip[2])])
        path = spline([grip, middle, end], 14)
        wide = blade.bar * np.interp(np.linspace(0, 1, 14), [0, 0.5, 1], [1.0, 1.6, 1.2])
        return [sweep(path, up, section * np.stack([wide / blade.bar, np.ones(14)], 1)[:, None])], grip
    if blade.handle == "hook":
        return [sweep(loop[:22], up, section)], grip
    swell = 1 + 0.35 * blade.egg * np.cos(np.arange(32) * 2 * np.pi / 32)
    return [sweep(loop, up, section * np.stack([swell, np.ones(32)], 1)[:, None], closed=True)], grip


def _mirrored(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices * [-1.0, 1.0, 1.0], mesh.faces[:, ::-1])
