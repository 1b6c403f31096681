"""Random eyeglasses: full, half and no rims, shields, round to rectangular to cat-eye, flat to wrap-around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...categories import EYEGLASSES
from ...geometry import MIRROR_X
from ...objects import Mesh, ObjectModel
from .shapes import box, ellipse, loft, merge, rounded_rectangle, spline, sweep, warp

LENS = 26
"""Points of a lens's outline."""


@dataclass(frozen=True)
class _Front:
    """The flat pattern of the front at +x; it is bent about a vertical axis afterwards."""

    outline: np.ndarray
    """(LENS, 2) edge of the lens, counter-clockwise from its outermost point."""
    inner: float
    """x of the edge nearest to the nose."""
    outer: float
    """x of the edge farthest from it."""
    rim: tuple[float, float]
    """Width in the pattern, depth across it."""
    height: float
    """Half height of a lens."""
    hinge_y: float


def eyeglasses(rng: np.random.Generator, name: str) -> ObjectModel:
    """One pair, unfolded. The nose is at the origin, the viewer's side at +z."""
    half = rng.uniform(0.058, 0.08)
    front = _draw_front(rng, half)
    solids = _front_solids(rng, front)
    bend, tilt = _bend(rng, half), rng.uniform(-0.02, 0.15)

    def shaped(points: np.ndarray) -> np.ndarray:
        bent = bend(points)
        return bent + np.stack([0 * bent[:, 0], 0 * bent[:, 0], tilt * bent[:, 1]], 1)  # lenses lean to the cheeks

    corner = shaped(np.array([[half, front.hinge_y, 0.0]]))[0]
    hinge = corner + [0.0, 0.0, -rng.uniform(0.002, 0.016)]
    temple, thick = _temple(rng, hinge, half)
    solids = [warp(solid, shaped) for solid in solids]
    solids += _end_piece(rng, shaped(np.array([[front.outer - 0.004, front.hinge_y, 0.0]]))[0], corner, hinge, thick)
    if rng.random() < 0.6:
        solids += _nose_pads(rng, shaped(np.array([[front.inner, -0.35 * front.height, 0.0]]))[0])

    frame = merge([*solids, *(_mirrored(solid) for solid in solids)])
    lean = rng.normal(0.0, 0.02, 2) * (rng.random() < 0.5)
    axis = np.array([lean[0], 1.0, lean[1]]) / np.linalg.norm([lean[0], 1.0, lean[1]])
    pivot = hinge + [rng.uniform(-0.6, 0.6) * thick, 0.0, 0.0]
    return ObjectModel(
        name=name,
        category=EYEGLASSES.name,
        part_names=tuple(part.name for part in EYEGLASSES.parts),
        parts=(frame, temple, _mirrored(temple)),
        joint_names=tuple(joint.name for joint in EYEGLASSES.joints),
        tree=EYEGLASSES.tree,
        axes=np.stack([axis, axis * MIRROR_X]),
        pivots=np.stack([pivot, pivot * MIRROR_X]),
        limits=np.array([joint.limits for joint in EYEGLASSES.joints]),
    ).centred()


def _mirrored(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices * MIRROR_X, mesh.faces[:, ::-1])


def _bend(rng: np.random.Generator, half: float):
    """Wrap the pattern around a vertical cylinder; x, y, depth -> space."""
    # most fronts are nearly flat, sports glasses go half round the head
    strength = rng.uniform(0.0, 0.35) if rng.random() < 0.6 else rng.uniform(0.3, 1.1)
    radius = half / max(strength, 1e-3)

    def bend(points: np.ndarray) -> np.ndarray:
        angle = points[:, 0] / radius
        reach = radius + points[:, 2]
        return np.stack([reach * np.sin(angle), points[:, 1], reach * np.cos(angle) - radius], 1)

    return bend


def _draw_front(rng: np.random.Generator, half: float) -> _Front:
    nose = rng.uniform(0.006, 0.012)
    outer = half - rng.choice([rng.uniform(0.0, 0.003), rng.uniform(0.002, 0.012)])
    a = (outer - nose) / 2
    height = float(np.clip(a * rng.uniform(0.5, 1.15), 0.012, 0.031))
    # exponents 2 (round) to 6 (rectangular), above and below apart; drops, cat-eyes and trapezes by bending that
    top, bottom = rng.uniform(1.9, 6.0), rng.uniform(1.9, 4.5)
    t = np.arange(LENS) * 2 * np.pi / LENS
    power = 2 / np.where(np.sin(t) > 0, top, bottom)
    x = np.sign(np.cos(t)) * np.abs(np.cos(t)) ** power
    y = np.sign(np.sin(t)) * np.abs(np.sin(t)) ** power
    taper, lift, drop = rng.normal(0.0, 0.1), rng.normal(0.05, 0.12), rng.uniform(0.0, 0.25)
    x, y = x * (1 + taper * y), y + lift * x * np.abs(x) - drop * np.clip(-y, 0, 1) * x * 0.5
    outline = np.stack([(outer + nose) / 2 + a * x, height * y], 1)
    outline[:, 0] = np.maximum(outline[:, 0], 0.004)
    thick = rng.random() < 0.5
    rim = (rng.uniform(0.003, 0.008), rng.uniform(0.003, 0.006)) if thick else tuple(rng.uniform(0.0015, 0.003, 2))
    hinge_y = height * rng.uniform(-0.1, 0.95)
    return _Front(outline, float(outline[:, 0].min()), outer, rim, height, hinge_y)


def _front_solids(rng: np.random.Generator, front: _Front) -> list[Mesh]:
    """Lens, rim and half a bridge at +x, flat."""
    kind = rng.random()
    if kind < 0.15:
        return _shield(rng, front)
    glass, bulge = rng.uniform(0.001, 0.0022), rng.uniform(0.0, 0.003)
    solids = []
    rimless = kind < 0.27
    if rimless or rng.random() < 0.85:
        solids.append(_lens(front.outline, glass, bulge))
    loop = np.pad(front.outline, ((0, 0), (0, 1)))
    forward = np.array([0.0, 0.0, 1.0])
    section = rounded_rectangle(*front.rim, 0.45 * min(front.rim), 1)
    if not rimless and kind < 0.42:  # a half rim: along the brow, some way down the sides
        reach = int(LENS * rng.uniform(0.02, 0.12))
        arc = np.arange(-reach, LENS // 2 + reach + 1) % LENS
        solids.append(sweep(loop[arc], forward, section))
    elif not rimless:
        heavy_brow = 1 + rng.choice([0.0, rng.uniform(0.3, 1.5)]) * np.clip(front.outline[:, 1] / front.height, 0, 1)
        sections = section * np.stack([heavy_brow, np.ones(LENS)], 1)[:, None]
        solids.append(sweep(loop, forward, sections, closed=True))
    return solids + _bridge(rng, front, max(front.rim[0], 0.002))


def _lens(outline: np.ndarray, thickness: float, bulge: float) -> Mesh:
    """A slab with two faces that bulge forward."""
    centre = outline.mean(0)
    rings = []
    for depth, shares in ((-thickness / 2, (0.05, 0.6)), (thickness / 2, (1.0, 0.6, 0.05))):
        for share in (*shares, 1.0) if depth < 0 else shares:
            ring = centre + share * (outline - centre)
            rings.append(np.column_stack([ring, np.full(len(ring), depth + bulge * (1 - share**2))]))
    return loft(np.stack(rings))


def _bridge(rng: np.random.Generator, front: _Front, width: float) -> list[Mesh]:
    """Half of one or two bars over the nose."""
    bars = []
    heights = [rng.uniform(0.0, 0.7)] if rng.random() < 0.85 else [rng.uniform(0.0, 0.3), rng.uniform(0.75, 1.0)]
    for share in heights:
        y = share * front.height
        edge = front.outline[front.outline[:, 0] < front.outline[:, 0].mean()]
        x = float(edge[np.abs(edge[:, 1] - y).argmin(), 0])
        rise = rng.uniform(0.0, 0.004)
        path = np.array([[0.0, y + rise, 0.0], [0.5 * x, y + 0.8 * rise, 0.0], [x + 0.0005, y, 0.0]])
        tall = width * rng.uniform(0.8, 2.5)
        bars.append(sweep(path, np.array([0.0, 0.0, 1.0]), rounded_rectangle(tall, front.rim[1], 0.001, 1)))
    return bars


def _shield(rng: np.random.Generator, front: _Front) -> list[Mesh]:
    """One lens or pierced plate across both eyes, with a notch for the nose; half of it."""
    x = np.linspace(0.0, front.outer, 24)
    u = x / front.outer
    corner = (1 - np.clip((u - 0.75) / 0.25, 0, 1) ** rng.uniform(1.5, 4)) ** 0.5
    top = front.height * (rng.uniform(0.7, 1.0) * np.maximum(corner, 0.25) + rng.uniform(-0.1, 0.1) * u)
    notch = rng.uniform(0.5, 1.1) * np.exp(-((x / rng.uniform(0.009, 0.015)) ** 2))
    bottom = -front.height * np.maximum(corner * (1 - notch), 0.15 * (notch < 0.5) - 0.2)
    top = np.maximum(top, bottom + 0.004)
    thickness = rng.uniform(0.0015, 0.004)
    rings = np.stack(
        [
            np.stack([x, bottom, 0 * x - thickness / 2], 1),
            np.stack([x, top, 0 * x - thickness / 2], 1),
            np.stack([x, top, 0 * x + thickness / 2], 1),
            np.stack([x, bottom, 0 * x + thickness / 2], 1),
        ],
        1,
    )
    solids = [loft(rings)]
    if rng.random() < 0.5:
        bar = np.stack([x, top, 0 * x], 1)
        solids.append(
            sweep(bar, np.array([0.0, 0.0, 1.0]), rounded_rectangle(1.3 * front.rim[0], 1.3 * front.rim[1], 0.001, 1))
        )
    return solids


def _end_piece(rng, start: np.ndarray, corner: np.ndarray, hinge: np.ndarray, thick: float) -> list[Mesh]:
    """From the rim's outer edge around the corner to the hinge."""
    tall = rng.uniform(0.003, 0.009)
    path = spline([start, corner - [0.5 * thick, 0, 0.0], 0.5 * (corner + hinge), hinge], 8)
    return [sweep(path, np.array([0.0, 1.0, 0.0]), rounded_rectangle(max(thick, 0.002), tall, 0.0008, 1))]


def _nose_pads(rng: np.random.Generator, place: np.ndarray) -> list[Mesh]:
    """A pad on its arm."""
    size = np.array([rng.uniform(0.001, 0.002), rng.uniform(0.004, 0.008), rng.uniform(0.0025, 0.004)])
    pad_centre = place + [-rng.uniform(-0.001, 0.002), rng.uniform(-0.004, 0.004), -rng.uniform(0.004, 0.01)]
    lean = rng.uniform(0.1, 0.5)
    levels = np.linspace(-1, 1, 6)
    disc = ellipse(1.0, 1.0, 10)
    rings = [np.column_stack([np.full(10, h), disc * np.sqrt(max(1 - (0.97 * h) ** 2, 0.02))]) for h in levels]
    pad = warp(loft(np.stack(rings)), lambda v: v * size)
    pad = warp(pad, lambda v: pad_centre + v + np.stack([-lean * v[:, 1] * 0.5, 0 * v[:, 0], 0 * v[:, 0]], 1))
    arm = box(np.minimum(place, pad_centre) - 0.0006, np.maximum(place, pad_centre) + 0.0006)
    return [pad, arm] if rng.random() < 0.7 else [pad]


def _temple(rng: np.random.Generator, hinge: np.ndarray, half: float) -> tuple[Mesh, float]:
    """The temple at +x, straight back with a bent tip, and its thickness at the hinge."""
    length = half * rng.uniform(1.15, 2.35)
    thick = rng.uniform(0.0012, 0.002) if rng.random() < 0.4 else rng.uniform(0.002, 0.005)
    tip = rng.uniform(0.18, 0.38) * length
    droop = np.radians(rng.uniform(0.0, 60.0)) * (rng.random() < 0.85)
    bow, splay, slope = rng.normal(0.0, 0.004), rng.normal(-0.02, 0.05), rng.normal(-0.02, 0.04)
    s = np.linspace(0.0, 1.0, 24)
    bent = droop * np.clip((s * length - (length - tip)) / tip, 0, 1) ** rng.uniform(0.5, 1.5)
    step = length / 23
    z = -np.concatenate([[0.0], np.cumsum(np.cos(bent[1:]) * step)])
    y = slope * s * length - np.concatenate([[0.0], np.cumsum(np.sin(bent[1:]) * step)])
    x = 4 * bow * s * (1 - s) + splay * s * length - rng.uniform(0.0, 0.006) * s**4
    path = hinge + np.stack([x, y, z], 1)

    root = rng.uniform(0.0025, 0.006) if rng.random() < 0.5 else rng.uniform(0.006, 0.022)
    middle = root * rng.uniform(0.45, 1.05)
    end = max(middle * rng.uniform(0.7, 1.6), 0.002)
    tall = np.interp(s, [0, rng.uniform(0.3, 0.6), 0.85, 1], [root, middle, end, 0.75 * end])
    wide = thick * np.interp(s, [0, 0.3, 1], [1.0, 1.0, rng.uniform(0.6, 1.4)])
    outline = rounded_rectangle(1.0, 1.0, rng.uniform(0.15, 0.45), 1)
    sections = outline * np.stack([tall, wide], 1)[:, None]
    return sweep(path, np.array([1.0, 0.0, 0.0]), sections), thick
