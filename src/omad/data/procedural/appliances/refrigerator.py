"""Random refrigerators: of one door from table height to man's height, or of two doors side by side."""

from dataclasses import replace

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, loft, slab
from ..vocabulary.cases import Case, Rect, shelves
from ..vocabulary.doors import bow, leaf, liner, pivot_at_side
from ..vocabulary.handles import handle
from ..vocabulary.stands import feet


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One refrigerator, shut; as many doors as the category has joints, the first hinged at the left, the second at the
    right. Body on y = 0 .. height, its front plane at z = 0, the room at +z. Unusual ones have rounded upper
    corners, or thin doors; wide gaps; hinges at the body's sides."""
    pair = len(category.joints) == 2
    width = rng.uniform(0.7, 1.1) if pair else rng.uniform(0.42, 0.78)
    height = width * rng.uniform(1.35, 2.3) if pair else width * rng.uniform(1.1, 2.9)
    height = min(height, 1.8)
    depth = (0.45 + 0.4 * width) * rng.uniform(0.7, 1.3)
    wall, thickness = rng.uniform(0.02, 0.07), rng.uniform(0.03, 0.11)
    low, high = height * rng.uniform(0.0, 0.1), height * (1 - rng.choice([0.0, rng.uniform(0.0, 0.08)]))
    arch = 0.0
    if unusual and unusual.random() < 0.6:
        arch, high = width * unusual.uniform(0.03, 0.25), height
    elif unusual:
        thickness *= unusual.uniform(0.25, 1.0)
    drawer = 0.0
    if rng.random() < (0.25 if pair else 0.12):  # one that is no part of the category: it stays shut
        drawer = height * rng.uniform(0.18, 0.34)
    bottom = low + drawer
    case = Case(width, height, depth, wall, wall, bottom + wall, height - high + wall, wall)
    mouth = case.mouth
    crude = rng.random() < 0.1
    if crude and not arch:
        body = [case.front.slab(-depth, 0.0)]
    else:
        body = case.arched_walls(arch) if arch else case.walls()
        body += shelves(rng, replace(case, top=case.top + arch), 5, 0.12)
    gap = rng.uniform(0.001, 0.008)
    if unusual:
        gap = unusual.choice([gap, unusual.uniform(0.005, 0.05)])
    outer = Rect(-width / 2, width / 2, bottom + gap, high)
    if drawer:
        front = Rect(-width / 2, width / 2, low, bottom - gap)
        body += [front.slab(-0.002, thickness), *handle(rng, front, thickness, "top")]
    body += _rest(rng, width, height, depth, low, high, thickness, arch)

    split = width * (rng.choice([0.0, rng.uniform(-0.15, 0.15)])) if pair else 0.0
    if not pair:
        doors = [(outer, mouth)]
    else:
        doors = [
            (replace(outer, x1=split - gap / 2), replace(mouth, x1=split - gap)),
            (replace(outer, x0=split + gap / 2), replace(mouth, x0=split + gap)),
        ]
        if not crude and rng.random() < 0.5:  # a wall between freezer and cooler
            half = rng.uniform(0.01, 0.03)
            body.append(box((split - half, mouth.y0, -depth + wall), (split + half, mouth.y1, -0.01)))
            doors = [(outer, inner.grown(-half, 0.0)) for outer, inner in doors]
    behind = max(unusual.uniform(-0.03, 0.1), 0.0) if unusual else 0.0
    return _hung(rng, body, doors, thickness, crude, width, arch, behind)


def _hung(
    rng: np.random.Generator,
    body: list[Mesh],
    doors: list[tuple[Rect, Rect]],
    thickness: float,
    crude: bool,
    width: float,
    arch: float,
    behind: float,
) -> JointedParts:
    """With its doors, all of one make, the second one as the mirror image of a left one; they may hang from the body's
    sides, so far behind its front."""
    made, moving, pivots = int(rng.integers(2**31)), [], []
    kind, grip, bulge = rng.uniform(0.0, 1.0), rng.uniform(0.7, 1.2), rng.uniform(0.02, 0.08)
    for number, (outer, mouth) in enumerate(doors):
        alike = np.random.default_rng(made)  # doors of a pair look alike
        turned = number == 1
        outer, mouth = (outer.mirrored(), mouth.mirrored()) if turned else (outer, mouth)
        pivot = pivot_at_side(alike, outer, thickness, False)
        if behind:
            pivot = np.array([outer.x0 + 0.1 * behind, 0.0, -behind])
        solids = leaf(alike, outer, 0.001, thickness, windows=0.06, panels=0.15)
        if arch:
            outline = outer.arched(arch, right=len(doors) == 1)
            solids = [loft(np.stack([np.insert(outline, 2, z, 1) for z in (0.001, thickness)]))]
        elif kind < 0.1:
            solids += bow(outer, 0.5 * thickness, thickness, bulge * width)
        if alike.random() < 0.8:
            solids += handle(alike, outer, thickness, "right", grip)
        if not crude and not arch and alike.random() < 0.75:
            solids += liner(alike, outer, 0.0, mouth, 0.09)
        moving.append(merge_meshes([solid.mirrored() for solid in solids] if turned else solids))
        pivots.append(pivot * [-1 if turned else 1, 1, 1])
    return JointedParts((merge_meshes(body), *moving), np.array(pivots))


def _rest(rng: np.random.Generator, width, height, depth, low, high, thickness, arch) -> list[Mesh]:
    """Plinth, top, feet."""
    solids, x = [], width / 2
    if low > 0.03 and rng.random() < 0.7:
        solids.append(box((-x, 0.0, -0.02), (x, low - 0.004, thickness * rng.uniform(0.0, 0.7) + 0.002)))
    if height - high > 0.02 and rng.random() < 0.6:
        solids.append(box((-x, high + 0.004, -0.02), (x, height, thickness * rng.uniform(0.1, 1.0))))
    if not arch and rng.random() < 0.25:
        solids.append(
            slab(
                (-x, height, -depth),
                (x, height + rng.uniform(0.005, 0.03), thickness * rng.uniform(0.0, 1.0)),
                1,
                0.004,
            )
        )
    return solids + feet(rng, x, depth, 0.05)
