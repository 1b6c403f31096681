"""Random suitcases that lie on their back: two shells, hinged at the rear, with handles, wheels and locks."""

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder, loft, points, tube
from ..vocabulary.vessels import Outline


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One suitcase, shut. Its lower shell on y = 0 .. rim, its middle at x = z = 0, the handle at the front."""
    width = rng.uniform(0.38, 0.8)
    depth, thick = width * rng.uniform(0.55, 0.8), width * rng.uniform(0.16, 0.42)
    rim = thick * rng.choice([0.5, rng.uniform(0.4, 0.75)])
    wall = rng.uniform(0.002, 0.008)
    outline = Outline(width, depth, rng.choice([rng.uniform(0.0, 0.1), rng.uniform(0.1, 0.5)]))
    flare = rng.uniform(0.88, 1.0)
    soft = 0.3 * min(rim, thick - rim) * rng.uniform(0.1, 1.0)
    body = [_half(outline, 0.0, rim - 0.0005, wall, flare, soft)]
    moving = [_half(outline, thick, rim + 0.0005, wall, flare, soft)]
    if rng.random() < 0.4:  # grooves
        for x in np.linspace(-0.35, 0.35, int(rng.integers(3, 8))) * width * flare:
            for part, low, high in ((body, -0.004, 0.001), (moving, thick - 0.001, thick + 0.004)):
                part.append(box((x - 0.008, low, -0.42 * depth * flare), (x + 0.008, high, 0.42 * depth * flare)))
    if rng.random() < 0.5:  # a band along the opening
        out, tall = rng.uniform(0.002, 0.006), rng.uniform(0.006, 0.02)
        body.append(outline.hoop(rim - tall, rim - 0.0006, 0.5 * wall, out))
        moving.append(outline.hoop(rim + 0.0006, rim + tall, 0.5 * wall, out))
    front, carried = depth / 2, rim * rng.uniform(0.55, 0.85)
    body += _grip(rng, width * rng.uniform(0.1, 0.2), carried, front)
    if rng.random() < 0.5:
        side = _grip(rng, depth * rng.uniform(0.1, 0.2), carried, width / 2)
        body += [solid.warped(lambda v: points(v[:, 2], v[:, 1], -v[:, 0])) for solid in side]
    if rng.random() < 0.7:
        for x in (-0.3, 0.3) if rng.random() < 0.7 else (0.0,):  # locks
            half, tall = rng.uniform(0.02, 0.05), rng.uniform(0.01, 0.03)
            low, high = (x * width - half, rim - tall, front - 0.004), (x * width + half, rim - 0.001, front + 0.012)
            body.append(box(low, high))
    if rng.random() < 0.6:
        body += _wheels(rng, width * flare, depth * flare, rim)
    radius = rng.uniform(0.003, 0.008)
    pivot = np.array([0.0, rim, -depth / 2 - radius * rng.uniform(0.8, 1.2) - 0.006])
    for x in (-0.3, 0.3):
        part = body if rng.random() < 0.5 else moving
        low, high = rim - 0.5 * radius, rim + 0.5 * radius
        part.append(cylinder((x * width - 0.04, *pivot[1:]), (x * width + 0.04, *pivot[1:]), radius, 8))
        arm = (low - 0.01, rim - 0.001) if part is body else (rim + 0.001, high + 0.01)
        part.append(box((x * width - 0.03, arm[0], pivot[2]), (x * width + 0.03, arm[1], -depth / 2 + wall)))
    return JointedParts((merge_meshes(body), merge_meshes(moving)), pivot[None])


def _half(outline: Outline, flat: float, rim: float, wall: float, flare: float, soft: float) -> Mesh:
    """One shell, hollow towards the rim; ``soft`` rounds the edge of its flat side."""
    up = 1.0 if rim > flat else -1.0
    rings = [outline.ring(flat, -0.6 * soft, flare), outline.ring(flat + up * soft, 0.0, flare), outline.ring(rim)]
    rings += [outline.ring(rim, -wall), outline.ring(flat + up * (soft + wall), -wall, flare)]
    return loft(np.stack(rings))


def _grip(rng: np.random.Generator, half: float, y: float, front: float) -> list[Mesh]:
    """A handle on the front, an arch or a bar on posts."""
    reach, thick = rng.uniform(0.02, 0.05), rng.uniform(0.006, 0.012)
    if rng.random() < 0.5:
        s = np.linspace(-1, 1, 9)
        return [tube(points(s * half, y, front - 0.004 + reach * (1 - np.abs(s) ** 4)), thick)]
    ends = [
        box((s * half - thick, y - thick, front - 0.004), (s * half + thick, y + thick, front + reach)) for s in (-1, 1)
    ]
    return [*ends, box((-half - thick, y - thick, front + reach - thick), (half + thick, y + thick, front + reach))]


def _wheels(rng: np.random.Generator, width: float, depth: float, rim: float) -> list[Mesh]:
    """On the side opposite to the handle, where it stands when it is upright: at the left end, or at the rear."""
    radius, thick = rng.uniform(0.015, 0.035), rng.uniform(0.012, 0.03)
    y = min(0.4 * rim, radius * 1.2)
    solids = []
    for z in (-0.38 * depth, 0.38 * depth):
        x = -width / 2 - 0.4 * radius
        solids.append(cylinder((x, y, z - thick), (x, y, z + thick), radius, 14))
        solids.append(
            box((x, y - 0.4 * radius, z - 0.6 * thick), (-width / 2 + 0.02, y + 0.4 * radius, z + 0.6 * thick))
        )
    return solids
