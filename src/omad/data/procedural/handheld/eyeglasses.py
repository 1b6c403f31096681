"""Random eyeglasses: full, half and no rims, shields, round to rectangular to cat-eye, flat to wrap-around; some with
fronts that are much tilted against the temples."""

from collections.abc import Callable

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.geometry.transforms import MIRROR_X
from omad.objects.category import Category

from ..shapes import JointedParts, X, Y, Z, box, ellipse, loft, points, rounded_rectangle, spline, squared, sweep, taper

LENS = 26
"""Points of a lens's outline."""


class _Front:
    """The flat pattern of the front at +x; it is bent about a vertical axis afterwards."""

    def __init__(self, rng: np.random.Generator, half: float) -> None:
        nose = rng.uniform(0.006, 0.012)
        self.outer = half - rng.choice([rng.uniform(0.0, 0.003), rng.uniform(0.002, 0.012)])
        """x of the edge farthest from the nose."""
        a = (self.outer - nose) / 2
        self.height = float(np.clip(a * rng.uniform(0.5, 1.15), 0.012, 0.031))
        """Half height of a lens."""
        # exponents 2 (round) to 6 (rectangular), above and below apart; drops, cat-eyes and trapezes by bending that
        top, bottom = rng.uniform(1.9, 6.0), rng.uniform(1.9, 4.5)
        t = np.arange(LENS) * 2 * np.pi / LENS
        power = 2 / np.where(np.sin(t) > 0, top, bottom)
        x, y = squared(np.cos(t), power), squared(np.sin(t), power)
        narrow, lift, drop = rng.normal(0.0, 0.1), rng.normal(0.05, 0.12), rng.uniform(0.0, 0.25)
        x, y = x * (1 + narrow * y), y + lift * x * np.abs(x) - drop * np.clip(-y, 0, 1) * x * 0.5
        x = np.maximum((self.outer + nose) / 2 + a * x, 0.004)
        self.outline = np.stack([x, self.height * y], 1)
        """(LENS, 2) edge of the lens, counter-clockwise from its outermost point."""
        self.inner = float(x.min())
        """x of the edge nearest to the nose."""
        thick = rng.random() < 0.5
        self.rim = (rng.uniform(0.003, 0.008), rng.uniform(0.003, 0.006)) if thick else rng.uniform(0.0015, 0.003, 2)
        """Width in the pattern, depth across it."""
        self.hinge_y = self.height * rng.uniform(-0.1, 0.95)


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One pair, unfolded. The nose is at the origin, the viewer's side at +z."""
    half = rng.uniform(0.058, 0.08)
    front = _Front(rng, half)
    flat = _front_solids(rng, front)
    tilted = _Tilted(unusual)
    shaped = _bend(rng, half, tilted.front)
    corner, start = shaped(np.array([[half, front.hinge_y, 0.0], [front.outer - 0.004, front.hinge_y, 0.0]]))
    hinge = corner + [0.0, 0.0, -rng.uniform(0.002, 0.016)]
    temple, thick = _temple(rng, hinge, half, tilted.temples)
    solids = [solid.warped(shaped) for solid in flat]
    solids.append(_end_piece(rng, start, corner, hinge, thick))
    if rng.random() < 0.6:
        solids += _nose_pads(rng, shaped(np.array([[front.inner, -0.35 * front.height, 0.0]]))[0])

    frame = merge_meshes([*solids, *(solid.mirrored() for solid in solids)])
    lean = rng.normal(0.0, 0.02, 2) * (rng.random() < 0.5)
    axis = np.array([lean[0], 1.0, lean[1] + tilted.axis])
    axis /= np.linalg.norm(axis)
    pivot = hinge + [rng.uniform(-0.6, 0.6) * thick, 0.0, 0.0]
    axes, pivots = np.stack([axis, axis * MIRROR_X]), np.stack([pivot, pivot * MIRROR_X])
    return JointedParts((frame, temple, temple.mirrored()), pivots, axes)


class _Tilted:
    """How much front, hinges and temples of an unusual pair lean against each other beyond what is usual: seen from
    the side, lenses lean to the cheeks, and hinges with them, more or less; or the temples rise or fall."""

    front = temples = axis = 0.0

    def __init__(self, rng: np.random.Generator | None) -> None:
        if rng is None:
            return
        tilt = rng.choice([rng.uniform(0.05, 0.3), rng.uniform(-0.15, 0.0)])
        by_front = rng.random() < 0.5
        self.front = tilt * by_front
        """Depth per height."""
        self.temples = tilt * (not by_front)
        """Rise per length."""
        self.axis = tilt * rng.uniform(0.0, 1.1)
        """As the front's: of hinges that go with the front, or stand across the temples."""


def _bend(rng: np.random.Generator, half: float, lean: float) -> Callable[[np.ndarray], np.ndarray]:
    """Wrap the pattern (N, 3), x, y and depth, around a vertical cylinder, and lean it by ``lean`` more than usual."""
    # most fronts are nearly flat, sports glasses go half round the head
    strength = rng.uniform(0.0, 0.35) if rng.random() < 0.6 else rng.uniform(0.3, 1.1)
    radius, tilt = half / max(strength, 1e-3), lean + rng.uniform(-0.02, 0.15)

    def bend(pattern: np.ndarray) -> np.ndarray:
        x, y, depth = pattern.T
        angle, reach = x / radius, radius + depth
        # lenses lean to the cheeks
        return points(reach * np.sin(angle), y, reach * np.cos(angle) - radius + tilt * y)

    return bend


def _front_solids(rng: np.random.Generator, front: _Front) -> list[Mesh]:
    """Lens, rim and half a bridge at +x, flat."""
    kind = rng.random()
    if kind < 0.15:
        return _shield(rng, front)
    glass, bulge = rng.uniform(0.001, 0.0022), rng.uniform(0.0, 0.003)
    rimless = kind < 0.27
    solids = [_lens(front.outline, glass, bulge)] if rimless or rng.random() < 0.85 else []
    loop = np.pad(front.outline, ((0, 0), (0, 1)))
    section = rounded_rectangle(front.rim[0], front.rim[1], 0.45 * min(front.rim), 1)
    if not rimless and kind < 0.42:  # a half rim: along the brow, some way down the sides
        reach = int(LENS * rng.uniform(0.02, 0.12))
        solids.append(sweep(loop[np.arange(-reach, LENS // 2 + reach + 1) % LENS], Z, section))
    elif not rimless:
        heavy_brow = 1 + rng.choice([0.0, rng.uniform(0.3, 1.5)]) * np.clip(front.outline[:, 1] / front.height, 0, 1)
        solids.append(sweep(loop, Z, taper(section, heavy_brow, 1.0), closed=True))
    return solids + _bridge(rng, front, max(front.rim[0], 0.002))


def _lens(outline: np.ndarray, thickness: float, bulge: float) -> Mesh:
    """A slab with two faces that bulge forward."""
    centre, half = outline.mean(0), thickness / 2
    levels = [(-half, 0.05), (-half, 0.6), (-half, 1.0), (half, 1.0), (half, 0.6), (half, 0.05)]
    rings = [(centre + share * (outline - centre), depth + bulge * (1 - share**2)) for depth, share in levels]
    return loft(np.stack([points(ring[:, 0], ring[:, 1], depth) for ring, depth in rings]))


def _bridge(rng: np.random.Generator, front: _Front, width: float) -> list[Mesh]:
    """Half of one or two bars over the nose."""
    bars = []
    heights = [rng.uniform(0.0, 0.7)] if rng.random() < 0.85 else [rng.uniform(0.0, 0.3), rng.uniform(0.75, 1.0)]
    edge = front.outline[front.outline[:, 0] < front.outline[:, 0].mean()]
    for share in heights:
        y = share * front.height
        x = float(edge[np.abs(edge[:, 1] - y).argmin(), 0])
        rise, tall = rng.uniform(0.0, 0.004), width * rng.uniform(0.8, 2.5)
        path = np.array([[0.0, y + rise, 0.0], [0.5 * x, y + 0.8 * rise, 0.0], [x + 0.0005, y, 0.0]])
        bars.append(sweep(path, Z, rounded_rectangle(tall, front.rim[1], 0.001, 1)))
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
    half = rng.uniform(0.0015, 0.004) / 2
    corners = [(bottom, -half), (top, -half), (top, half), (bottom, half)]
    solids = [loft(np.stack([points(x, y, z) for y, z in corners], 1))]
    if rng.random() < 0.5:
        wide, deep = 1.3 * np.array(front.rim)
        solids.append(sweep(points(x, top, 0.0), Z, rounded_rectangle(wide, deep, 0.001, 1)))
    return solids


def _end_piece(rng, start: np.ndarray, corner: np.ndarray, hinge: np.ndarray, thick: float) -> Mesh:
    """From the rim's outer edge around the corner to the hinge."""
    tall = rng.uniform(0.003, 0.009)
    path = spline([start, corner - [0.5 * thick, 0, 0.0], 0.5 * (corner + hinge), hinge], 8)
    return sweep(path, Y, rounded_rectangle(max(thick, 0.002), tall, 0.0008, 1))


def _nose_pads(rng: np.random.Generator, place: np.ndarray) -> list[Mesh]:
    """A pad on its arm."""
    size = np.array([rng.uniform(0.001, 0.002), rng.uniform(0.004, 0.008), rng.uniform(0.0025, 0.004)])
    pad_centre = place + [-rng.uniform(-0.001, 0.002), rng.uniform(-0.004, 0.004), -rng.uniform(0.004, 0.01)]
    lean = rng.uniform(0.1, 0.5)
    levels = np.linspace(-1, 1, 6)
    discs = ellipse(1.0, 1.0, 10) * np.sqrt(np.maximum(1 - (0.97 * levels) ** 2, 0.02))[:, None, None]
    pad = loft(points(levels[:, None], discs[..., 0], discs[..., 1])).warped(lambda v: v * size)
    pad = pad.warped(lambda v: pad_centre + v + points(-lean * v[:, 1] * 0.5, 0.0, 0.0))
    arm = box(np.minimum(place, pad_centre) - 0.0006, np.maximum(place, pad_centre) + 0.0006)
    return [pad, arm] if rng.random() < 0.7 else [pad]


def _temple(rng: np.random.Generator, hinge: np.ndarray, half: float, rise: float) -> tuple[Mesh, float]:
    """The temple at +x, straight back with a bent tip, rising by ``rise`` more than usual, and its thickness at the
    hinge."""
    length = half * rng.uniform(1.15, 2.35)
    thick = rng.uniform(0.0012, 0.002) if rng.random() < 0.4 else rng.uniform(0.002, 0.005)
    tip = rng.uniform(0.18, 0.38) * length
    droop = np.radians(rng.uniform(0.0, 60.0)) * (rng.random() < 0.85)
    bow, splay, slope = rng.normal(0.0, 0.004), rng.normal(-0.02, 0.05), rise + rng.normal(-0.02, 0.04)
    s = np.linspace(0.0, 1.0, 24)
    bent = droop * np.clip((s * length - (length - tip)) / tip, 0, 1) ** rng.uniform(0.5, 1.5)
    step = length / 23
    z = -np.concatenate([[0.0], np.cumsum(np.cos(bent[1:]) * step)])
    y = slope * s * length - np.concatenate([[0.0], np.cumsum(np.sin(bent[1:]) * step)])
    x = 4 * bow * s * (1 - s) + splay * s * length - rng.uniform(0.0, 0.006) * s**4
    path = hinge + points(x, y, z)

    root = rng.uniform(0.0025, 0.006) if rng.random() < 0.5 else rng.uniform(0.006, 0.022)
    middle = root * rng.uniform(0.45, 1.05)
    end = max(middle * rng.uniform(0.7, 1.6), 0.002)
    tall = np.interp(s, [0, rng.uniform(0.3, 0.6), 0.85, 1], [root, middle, end, 0.75 * end])
    wide = thick * np.interp(s, [0, 0.3, 1], [1.0, 1.0, rng.uniform(0.6, 1.4)])
    return sweep(path, X, taper(rounded_rectangle(1.0, 1.0, rng.uniform(0.15, 0.45), 1), tall, wide)), thick
