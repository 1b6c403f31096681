"""Random pliers: flat, pointed, bent and cutting ones, with bare or coated handles."""

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, Y, cylinder, ellipse, loft, points, rounded_rectangle, spline, sweep, taper


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One pair, shut, the pivot at the origin, the jaws along +z. The base has its jaw on the side of +x. Unusual ones
    are two plates, one upon the other from end to end."""
    length = rng.uniform(0.11, 0.26)
    thick = length * rng.uniform(0.03, 0.065)
    disc = length * rng.uniform(0.045, 0.085)  # around the pivot
    seed = int(rng.integers(2**31))
    squash = unusual.uniform(0.3, 0.5) if unusual else None
    halves = [_half(np.random.default_rng(seed), length, thick, disc, level, squash) for level in (1, -1)]
    base, child = halves[0], [solid.mirrored() for solid in halves[1]]
    reach, radius = thick * rng.uniform(0.52, 0.75), disc * rng.uniform(0.25, 0.6)
    base += [cylinder((0, s * 0.5 * thick, 0), (0, s * reach, 0), radius, 14) for s in (-1, 1)]  # the rivet's heads
    return JointedParts((merge_meshes(base), merge_meshes(child)), np.zeros((1, 3)))


def _half(rng: np.random.Generator, length: float, thick: float, disc: float, level: int, squash) -> list[Mesh]:
    """Jaw, joint and handle; the joint is in the upper half of the thickness, or in the lower one, and all of them,
    where they are to be squashed to a share of their own."""
    jaw = length * rng.uniform(0.14, 0.38)
    gap = 0.0003 + 0.012 * disc
    solids = [cylinder((0, level * gap / 2, 0), (0, level * thick / 2, 0), disc, 20)]
    solids.append(_jaw(rng, jaw, thick, disc, gap))
    solids.append(_root(thick, disc, gap, level))
    handle, spread = length - jaw - disc, length * rng.uniform(0.05, 0.13)
    solids += _handle(rng, handle, spread, thick, disc, gap, level)
    if squash is None:
        return solids
    flat, up = np.array([1.0, squash, 1.0]), np.array([0.0, level * thick / 4, 0.0])
    return [solid.warped(lambda vertices: vertices * flat + up) for solid in solids]


def _jaw(rng: np.random.Generator, jaw: float, thick: float, disc: float, gap: float) -> Mesh:
    """From the joint to the tip: its inner side along x = 0, its outer side tapered, and sometimes bent along y."""
    s = np.linspace(0.0, 1.0, 10)
    point, fullness = rng.uniform(0.12, 0.8), rng.uniform(0.6, 2.0)
    wide = disc * rng.uniform(0.75, 1.15) * (1 - (1 - point) * s**fullness)
    tall = thick * (1 - rng.uniform(0.0, 0.7) * s ** rng.uniform(0.7, 2.0))
    hollow = rng.uniform(0.0, 0.25) * disc * np.sin(np.pi * s) * (rng.random() < 0.4)
    bent = rng.uniform(0.2, 0.5) * jaw * s**2.5 if rng.random() < 0.15 else 0 * s
    z = 1.04 * disc + (jaw - 0.04 * disc) * s
    path = points(gap / 2 + hollow + (wide - hollow) / 2, bent, z)
    section = taper(rounded_rectangle(1.0, 1.0, 0.2, 2), wide - hollow, tall)
    return _upright(path, section)


def _root(thick: float, disc: float, gap: float, level: int) -> Mesh:
    """What joins the disc to the jaw, in its own half of the thickness."""
    y0, y1 = sorted((level * gap / 2, level * thick / 2))
    path = points(0.35 * disc + gap, (y0 + y1) / 2, np.array([0.3 * disc, 0.8 * disc, 1.2 * disc]))
    return _upright(path, rounded_rectangle(0.7 * disc, y1 - y0, 0.0, 1))


def _handle(rng: np.random.Generator, long, spread, thick, disc, gap, level: int) -> list[Mesh]:
    """Crosses over to the side of -x and runs back, straight or bowed; thicker where it is coated."""
    y = level * (thick + gap) / 4
    start = np.array([-0.45 * disc, y, -0.75 * disc])
    bow = rng.uniform(-0.2, 1.2)
    middle = [-0.5 * disc - spread * (0.5 + 0.4 * bow), 0.0, -disc - 0.5 * long]
    end = [-0.5 * disc - spread * rng.uniform(0.5, 1.1), 0.0, -disc - long]
    knee = [-0.5 * disc - 0.25 * spread, 0.3 * y, -disc - 0.15 * long]
    path = spline([start, knee, middle, end], 16)
    s = np.linspace(0.0, 1.0, 16)
    slim, grip = disc * rng.uniform(0.4, 0.75), rng.uniform(0.2, 0.45)
    coat = rng.uniform(1.3, 2.3) if rng.random() < 0.75 else 1.0
    swell = 1 + (coat - 1) * (s > grip) * (1 - 0.25 * s)
    wide = np.minimum(slim * swell, 1.6 * disc)
    tall = np.where(s < 0.12, thick / 2 - gap / 2, 0.8 * thick * np.where(s > grip, min(coat, 1.6), 1.0))
    wide[0], path[:, 0] = min(wide[0], 0.8 * disc), np.minimum(path[:, 0], -0.5 * wide - gap)
    round_ = rng.random() < 0.4
    section = ellipse(0.5, 0.5, 12) if round_ else rounded_rectangle(1.0, 1.0, rng.uniform(0.1, 0.45), 3)
    return [sweep(path, Y, taper(section, wide, tall))]


def _upright(path: np.ndarray, section: np.ndarray) -> Mesh:
    """Along a path in z whose cross-sections stay in planes of constant z."""
    section = np.broadcast_to(section, (len(path), *section.shape[-2:]))
    return loft(path[:, None] + points(section[..., 0], section[..., 1], 0.0))
