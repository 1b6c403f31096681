"""Racks of wire."""

import numpy as np

from omad.geometry.mesh import Mesh

from ..shapes import box


def rack(rng: np.random.Generator, x: float, y: float, ceiling: float, z0: float, z1: float) -> list[Mesh]:
    """A rack over x = -x .. x, z = z0 .. z1 at height ``y``: a shelf of bars or a tray, sometimes with a rail around
    three sides, below ``ceiling``. None where there is no room for one."""
    bar = rng.uniform(0.002, 0.006)
    if 2 * x < 0.1 or z1 - z0 < 0.1:
        return []

    def rod(xa: float, xb: float, y: float, za: float, zb: float) -> Mesh:
        return box((xa, y - bar, za), (xb, y + bar, zb))

    if rng.random() < 0.4:
        solids = [rod(-x, x, y, z0, z1)]
    else:
        solids = [rod(a - bar, a + bar, y, z0, z1) for a in np.linspace(-x, x, int(rng.integers(5, 12)))]
        solids += [rod(-x, x, y, z - bar, z + bar) for z in np.linspace(z0, z1, int(rng.integers(3, 7)))]
    if rng.random() < 0.6 and (rise := min(rng.uniform(0.03, 0.1), ceiling - y - 0.01)) > 0.01:
        for xa, xb, za in ((-x, -x, z0), (x, x, z0), (-x, x, z1)):
            solids += [rod(xa - bar, xb + bar, y + h, za - bar, z1 + bar) for h in (0.5 * rise, rise)]
    return solids
