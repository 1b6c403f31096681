"""Random ovens: cookers with a hob, built-in ones and table-top ones, with a door that drops to the front."""

from dataclasses import replace

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder, points, slab
from ..vocabulary.cases import Case, Rect, controls
from ..vocabulary.doors import fitted, leaf, liner, pressed
from ..vocabulary.handles import handle
from ..vocabulary.racks import rack
from ..vocabulary.stands import feet


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One oven, door closed, hinged below. Body on y = 0 .. height, its front plane at z = 0, the room at +z. Unusual
    ones have a tall drawer flush with the door, a hob that juts out to the front or to the back, a panel behind the
    body, and a back that is stepped; or all of them is sheet, with no tub inside."""
    cooker = rng.random() < 0.65
    width = rng.uniform(0.5, 0.9) if cooker else rng.uniform(0.42, 0.75)
    height = rng.uniform(0.7, 1.0) if cooker else width * rng.uniform(0.55, 1.1)
    depth = width * rng.uniform(0.65, 1.15) if cooker else rng.uniform(0.4, 0.65)
    wall = rng.uniform(0.01, 0.06)
    below = height * (rng.uniform(0.12, 0.34) if cooker else rng.choice([0.02, rng.uniform(0.02, 0.12)]))
    if unusual and cooker:
        below = height * unusual.uniform(0.2, 0.42)
    above = height * (rng.uniform(0.03, 0.22) if rng.random() < 0.75 else 0.02)
    low, high = (max(end, 0.015) + wall * rng.uniform(0.2, 1.0) for end in (below, above))
    case = Case(width, height, depth, wall, wall, low, high, rng.choice([wall, rng.uniform(0.05, 0.3) * depth]))
    front, mouth = case.front, case.mouth
    thickness = rng.uniform(0.02, 0.09)
    outer = replace(front, y0=front.y0 + below, y1=front.y1 - above)
    door, body = fitted(rng, outer, mouth, thickness, 0.15)
    hinge = rng.uniform(0.35, 1.0) * thickness
    pivot = np.array([0.0, door.y0 + rng.choice([0.0, rng.uniform(0.0, 0.3)]) * hinge, hinge])

    crude = rng.random() < 0.12
    sheet = unusual.uniform(0.001, 0.01) if unusual and unusual.random() < 0.4 else 0.0
    tub = not (crude or sheet)
    body += case.sheet(sheet) if sheet else [front.slab(-depth, 0.0)] if crude else case.walls()
    behind = 0.0
    if unusual and cooker and unusual.random() < 0.5:  # the body is deeper above
        behind = depth * unusual.uniform(0.0, 0.15)
        body.append(replace(front, y0=height * unusual.uniform(0.1, 0.9)).slab(-depth - behind, -depth))
    sink = thickness - hinge + 0.004  # how far the shut door's foot comes down
    body += _fronts(rng, front, outer.y0 - sink, outer.y1 + 0.002, thickness, hinge, unusual)
    if cooker:
        body += _hob(rng, width, height, depth, thickness, behind, unusual)
    body += feet(rng, width / 2, depth, 0.08)
    if tub:
        for level in sorted(rng.uniform(0.1, 0.8, int(rng.integers(0, 4)))):
            y = mouth.y0 + level * mouth.height
            body += rack(rng, mouth.width / 2 - 0.01, y, mouth.y1, -depth + case.back + 0.02, -0.06)

    faces = 0.0005, thickness
    moving = pressed(rng, door, *faces) if sheet else leaf(rng, door, *faces, windows=0.5, panels=0.3)
    if rng.random() < 0.85:
        moving += handle(rng, door, thickness, "top", rng.uniform(0.6, 1.0))
    if tub and rng.random() < 0.6:
        moving += liner(rng, door, 0.0, mouth, 0.05)
    return JointedParts((merge_meshes(body), merge_meshes(moving)), pivot[None])


def _fronts(rng: np.random.Generator, front: Rect, low, high, thickness, hinge, unusual) -> list[Mesh]:
    """What is below and above the door: a drawer's face or a plinth, and the controls."""
    solids = []
    margin = rng.choice([0.0, rng.uniform(0.0, 0.02)])
    if low > 0.05:
        face = Rect(front.x0 + margin, front.x1 - margin, rng.uniform(0.0, 0.5) * low, low)
        reach = rng.choice([0.002, hinge, rng.uniform(0.1, 1.0) * hinge])
        if unusual:
            reach = thickness * unusual.uniform(0.7, 1.1)
        solids.append(slab((face.x0, face.y0, -0.01), (face.x1, face.y1, reach), 2, 0.004))
        if rng.random() < (0.7 if unusual else 0.35) and face.height > 0.1:
            solids += handle(rng, face, reach, "top", 0.7 if unusual else 0.4)
    if front.y1 - high > 0.02:
        strip = Rect(front.x0, front.x1, high, front.y1)
        reach = thickness * rng.uniform(0.05, 1.1)
        solids.append(strip.slab(-0.01, reach))
        solids += controls(rng, strip.grown(-0.02, -0.15 * strip.height), reach, 8)
    return solids


def _hob(rng: np.random.Generator, width, height, depth, thickness, behind, unusual) -> list[Mesh]:
    """The top of a cooker, flat or with burners and grates, and what stands up behind it, upright or slanted."""
    lip = unusual.uniform(0.0, 0.05) if unusual else 0.0  # how much farther it juts out
    over, thick = lip + thickness * rng.uniform(0.0, 1.2), rng.uniform(0.005, 0.05)
    x, y = width / 2 + rng.uniform(0.0, 0.01), height + thick
    solids = [slab((-x, height, -depth - behind), (x, y, over), 1, rng.uniform(0.0, 0.02))]
    if rng.random() < 0.7:
        rise, columns = rng.uniform(0.003, 0.03), int(rng.integers(2, 4))
        grates = rng.random() < 0.4
        for a in (np.arange(columns) + 0.5) / columns - 0.5:
            for b in (-0.3, -0.72):
                r, (u, w) = rng.uniform(0.06, 0.13) * width, (0.9 * a * width, b * depth)
                solids.append(
                    cylinder((u, y, w), (u, y + rise * (0.4 if grates else 1), w), r * (0.6 if grates else 1), 14)
                )
                if grates:
                    bar = 0.008
                    solids.append(box((u - 1.3 * r, y + 0.7 * rise, w - bar), (u + 1.3 * r, y + rise, w + bar)))
                    solids.append(box((u - bar, y, w - 1.2 * r), (u + bar, y + rise, w + 1.2 * r)))
    if rng.random() < 0.5:
        rise, thick = rng.uniform(0.04, 0.28), rng.uniform(0.015, 0.1)
        panel = [box((-x, y, -depth), (x, y + rise, -depth + thick))]
        if rng.random() < 0.6:
            face = Rect(-0.8 * x, 0.8 * x, y + 0.3 * rise, y + 0.9 * rise)
            panel += controls(rng, face, -depth + thick, 6)
        if unusual:  # narrower, slanted, farther back, and down behind the body
            share, slant = [unusual.uniform(0.75, 1.0), 1.0, 1.0], unusual.choice([0.0, unusual.uniform(0.0, 0.5)])
            back, drop = behind + unusual.uniform(0.0, 1.0) * thick, unusual.uniform(0.002, 0.2) * height
            panel += [box((-x, y - drop, -depth), (x, y, -depth + thick))] if unusual.random() < 0.5 else []
            panel = [
                solid.warped(lambda at: at * share - points(0.0, 0.0, back + slant * np.maximum(at[:, 1] - y, 0.0)))
                for solid in panel
            ]
        solids += panel
    return solids
