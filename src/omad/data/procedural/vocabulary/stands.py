"""What things stand on: legs, runners, plinths, feet."""

import numpy as np

from omad.geometry.mesh import Mesh

from ..shapes import box, cylinder


def stand(rng: np.random.Generator, x: float, depth: float, base: float) -> list[Mesh]:
    """Below a body over x = -x .. x, z = -depth .. 0 and above y = ``base``: four legs, straight or round; two runners;
    or a plinth."""
    kind, size = rng.random(), rng.uniform(0.015, 0.04)
    inset = rng.uniform(0.0, 0.15)
    if kind < 0.25:
        return [box((-x, 0, -depth), (x, base, -rng.uniform(0.0, 0.06)))]
    if kind < 0.4:
        return [box((s * x - size, 0, -depth), (s * x + size, base, 0)) for s in (-1 + inset, 1 - inset)]
    solids = []
    for s in (-1, 1):
        for z in (-depth * (1 - 0.5 * inset) + size, -0.5 * inset * depth - size):
            a = s * (x * (1 - inset) - size)
            if kind < 0.7:
                solids.append(box((a - size, 0, z - size), (a + size, base, z + size)))
            else:
                splay = s * rng.uniform(0.0, 0.03)
                solids.append(cylinder((a + splay, 0, z), (a, base + 0.005, z), 0.8 * size))
    return solids


def feet(rng: np.random.Generator, x: float, depth: float, tallest: float, front: float = 0.0) -> list[Mesh]:
    """Four small feet below y = 0 under a body over x = -x .. x, ``depth`` deep behind z = ``front``; or none."""
    if rng.random() < 0.5:
        return []
    drop, r, inset = tallest * rng.uniform(0.15, 1.0), rng.uniform(0.03, 0.1) * min(2 * x, depth), rng.uniform(0.7, 0.9)
    places = [(s * x * inset, front - depth * (1 + t * inset) / 2) for s in (-1, 1) for t in (-1, 1)]
    if rng.random() < 0.3:
        return [box((a - r / 2, -drop, z - r / 2), (a + r / 2, 0.0, z + r / 2)) for a, z in places]
    return [cylinder((a, -drop, z), (a, 0.001, z), r / 2) for a, z in places]
