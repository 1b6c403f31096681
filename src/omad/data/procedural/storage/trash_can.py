"""Random trash cans with a hinged lid: pedal bins, office bins, wheeled bins."""

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder
from ..vocabulary.cases import Rect
from ..vocabulary.handles import handle
from ..vocabulary.stands import feet
from ..vocabulary.vessels import Outline, lid


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One can, shut, hinged at the back. Body on y = 0 .. rim, its middle at x = z = 0."""
    wheeled = rng.random() < 0.4
    rim = rng.uniform(0.55, 0.82) if wheeled else rng.uniform(0.48, 0.8)
    width = min(rim * rng.uniform(0.42, 0.8), 0.58)
    corner = rng.uniform(0.0, 0.5) if wheeled else rng.choice([rng.uniform(0.0, 0.35), rng.uniform(0.0, 1.0), 1.0])
    outline = Outline(width, width if corner == 1.0 else width * rng.uniform(0.7, 1.25), corner)
    wall, flare = rng.uniform(0.002, 0.012), rng.choice([1.0, rng.uniform(0.7, 1.0)])
    body = [outline.shell(0.0, rim, wall, rng.uniform(0.004, 0.03), flare)]
    tall = rim * rng.uniform(0.04, 0.22)
    if flare == 1.0 and rng.random() < 0.6:  # a collar, below where the lid may lap over the rim
        high = rim - 0.55 * tall
        body.append(outline.hoop(high - rng.uniform(0.015, 0.06), high, 0.5 * wall, rng.uniform(0.004, 0.012)))
    top = lid(rng, outline, rim, wall, tall)
    moving = list(top.solids)
    back, front = -outline.depth / 2, outline.depth / 2
    if wheeled:
        body += _wheels(rng, outline, flare)
    else:
        if corner < 0.5:
            body += feet(rng, flare * width / 2, 2 * flare * front, 0.03, flare * front)
        if rng.random() < 0.5:  # the pedal
            half, reach, y = rng.uniform(0.02, 0.06), rng.uniform(0.02, 0.06), rng.uniform(0.01, 0.04)
            body.append(box((-half, y, flare * front - 0.03), (half, y + 0.008, flare * front + reach)))
    if rng.random() < 0.35 and corner < 0.5 and top.top - top.hinge > 0.03:
        moving += handle(rng, Rect(-width / 2, width / 2, top.hinge, top.top), front + top.behind, "top", 0.3)
    pivot = np.array([0.0, top.hinge, back - top.behind - rng.choice([0.0, rng.uniform(0.0, 0.02)])])
    if wheeled or rng.random() < 0.4:
        half, radius = width * rng.uniform(0.15, 0.4), rng.uniform(0.004, 0.012)
        low, high = (rim - 0.06, pivot[2] - radius), (pivot[1], back + 0.5 * wall)
        body += [box((x - 0.01, *low), (x + 0.01, *high)) for x in (-half, half)]
        (body if rng.random() < 0.5 else moving).append(cylinder((-half, *pivot[1:]), (half, *pivot[1:]), radius))
    return JointedParts((merge_meshes(body), merge_meshes(moving)), pivot[None])


def _wheels(rng: np.random.Generator, outline: Outline, flare: float) -> list[Mesh]:
    """Two at the back, with their axle; the body stands on them and on its front edge."""
    radius, thick = rng.uniform(0.05, 0.13), rng.uniform(0.015, 0.05)
    x, z = flare * outline.width / 2 + 0.004, -flare * outline.depth / 2 + radius * rng.uniform(-0.2, 0.6)
    solids = [cylinder((s * x, radius - 0.02, z), (s * (x + thick), radius - 0.02, z), radius, 16) for s in (-1, 1)]
    return [*solids, cylinder((-x - 0.001, radius - 0.02, z), (x + 0.001, radius - 0.02, z), 0.012, 8)]
