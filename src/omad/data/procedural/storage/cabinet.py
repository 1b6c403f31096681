"""Random cabinets with one door or with two: wardrobes, kitchen units, lockers, sideboards with open shelves."""

from dataclasses import replace

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, slab
from ..vocabulary.cases import Case, Rect, shelves
from ..vocabulary.doors import fitted, fixed_fronts, leaf, pivot_at_side
from ..vocabulary.handles import handle
from ..vocabulary.stands import stand


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One cabinet, shut; as many doors as the category has joints, the first hinged at the left, the second at the
    right. What is above y = base is the body, its front plane at z = 0, the room at +z. Unusual ones with two doors
    have open or closed parts beside them or between, and may be wide and low."""
    pair = len(category.joints) == 2
    width = rng.uniform(0.55, 1.2) if pair else rng.choice([rng.uniform(0.36, 0.75), rng.uniform(0.6, 1.3)])
    tall = rng.uniform(0.5, 1.3) * width if rng.random() < 0.5 else rng.uniform(1.2, 3.2 if pair else 4.0) * width
    depth = rng.uniform(0.3, 0.65)
    wall, thickness = rng.uniform(0.008, 0.035), rng.uniform(0.01, 0.035)
    base = rng.choice([0.0, rng.uniform(0.02, 0.12), rng.uniform(0.05, 0.25)])
    tall = float(np.clip(tall, 0.6 if pair else 0.4, (1.8 if pair else 1.65) - base))
    if unusual and pair:
        width, tall = width * unusual.uniform(1.0, 1.6), tall * unusual.uniform(0.75, 1.0)
    if not pair and rng.random() < 0.25:  # as deep as it is wide: a door that is open looks like a side
        depth = float(np.clip(width * rng.uniform(0.85, 1.15), 0.3, 0.7))
    size = float(np.linalg.norm([width, base + tall, depth]))
    if not pair:  # neither a box for the wall nor one that no room holds
        width, tall, depth = np.array([width, tall, depth]) * np.clip(size, 0.84, 2.0) / size
    beside, stack = _open_parts(rng, width, tall, pair)
    if unusual and pair:
        beside, stack = _open_parts(unusual, width, tall, False)
        beside *= 0.6
    left, right, bottom, top = wall + beside[0], wall + beside[1], wall + stack[0], wall + stack[1]
    case = Case(width, base + tall, depth, left, right, bottom, top, 0.4 * wall, base)
    whole = case.front
    outer = Rect(whole.x0 + beside[0], whole.x1 - beside[1], whole.y0 + stack[0], whole.y1 - stack[1])
    door, body = fitted(rng, outer, case.mouth, thickness, 0.35)
    framed = bool(body)
    body += _carcass(rng, case, beside, stack, wall)
    if base > 0.015:
        body += stand(rng, width / 2, depth, base)
    if rng.random() < 0.5:
        over, side = thickness * rng.uniform(0.0, 1.3), rng.choice([0.0, rng.uniform(0.0, 0.03)])
        low, high = (-width / 2 - side, base + tall, -depth), (width / 2 + side, base + tall + wall, over)
        body.append(slab(low, high, 1, rng.uniform(0.0, 0.01)))
    between = 0.0
    if unusual and pair and not beside.any():
        between = door.width * unusual.uniform(0.1, 0.4)
        body += _bay(unusual, case, door.centre[0], between, wall)
    return _hung(rng, body, door, thickness, framed, pair, between)


def _hung(
    rng: np.random.Generator,
    body: list[Mesh],
    door: Rect,
    thickness: float,
    framed: bool,
    pair: bool,
    between: float,
) -> JointedParts:
    """With its door, or with two that share its place, ``between`` apart, and are of one make."""
    gap = rng.uniform(0.0008, 0.003) + 0.6 * thickness**2 / door.width
    split = door.centre[0] + (door.width * rng.uniform(-0.15, 0.15) if rng.random() < 0.2 and not between else 0.0)
    gap += between / 2
    spans = [replace(door, x1=split - gap), replace(door, x0=split + gap).mirrored()] if pair else [door]
    style, moving, pivots = int(rng.integers(2**31)), [], []
    handled, place, size = rng.random() < 0.85, rng.random(), rng.uniform(0.4, 0.9)
    for number, span in enumerate(spans):
        alike = np.random.default_rng(style)  # doors of a pair look alike
        pivot = pivot_at_side(alike, span, thickness, framed)
        solids = leaf(alike, span, 0.0008, thickness, windows=0.15, panels=0.4)
        if handled:
            middle = span.centre[1]
            part = span if place < 0.6 else replace(span, **({"y0": middle} if place < 0.8 else {"y1": middle}))
            solids += handle(alike, part, thickness, "right", size)
        sign = -1 if number else 1
        moving.append(merge_meshes([solid.mirrored() for solid in solids] if number else solids))
        pivots.append(pivot * [sign, 1, 1])
    return JointedParts((merge_meshes(body), *moving), np.array(pivots))


def _open_parts(rng: np.random.Generator, width: float, tall: float, pair: bool) -> tuple[np.ndarray, np.ndarray]:
    """How much of the front no door closes: left and right of them, and below and above."""
    aside = width * rng.uniform(0.2, 0.5) if not pair and width > 0.5 and rng.random() < 0.6 else 0.0
    at = rng.random() if aside > 0.15 else 0.5
    before = 0.0 if at < 0.7 else 1.0  # on the side of the handle, or of the hinge
    if at < 0.3:  # on both
        before, aside = rng.uniform(0.35, 0.65), rng.uniform(1.0, 1.5) * aside
    stack = tall * rng.uniform(0.15, 0.45, 2) * (rng.random(2) < (0.15, 0.15))
    return aside * np.array([before, 1 - before]), stack


def _bay(rng: np.random.Generator, case: Case, middle: float, between: float, wall: float) -> list[Mesh]:
    """Two uprights that part what is between two doors from what is behind them, and what closes it, if anything."""
    mouth, back = case.mouth, -case.depth + case.back
    bay = replace(mouth, x0=middle - between / 2, x1=middle + between / 2)
    wall = min(wall, 0.2 * between)
    edges = replace(bay, x1=bay.x0 + wall), replace(bay, x0=bay.x1 - wall)
    return [*(edge.slab(back, 0.0) for edge in edges), *fixed_fronts(rng, bay.grown(-wall, 0.0))]


def _carcass(rng: np.random.Generator, case: Case, beside: np.ndarray, stack: np.ndarray, wall: float) -> list[Mesh]:
    """The walls, with shelves behind the doors and in the open parts."""
    if rng.random() < 0.1:
        return [case.front.slab(-case.depth, 0.0)]
    whole = replace(case, left=wall, right=wall, bottom=wall, top=wall)
    mouth, inner, back = case.mouth, whole.mouth, -case.depth + case.back
    solids = [*whole.walls(), *shelves(rng, case, 4)]
    closed = rng.spawn(1)[0]
    for side, (open_part, edge) in enumerate(zip(beside, (mouth.x0 - wall, mouth.x1), strict=True)):
        if open_part:
            solids.append(box((edge, inner.y0, back), (edge + wall, inner.y1, 0.0)))
            room = {"left": edge + wall - case.front.x0} if side else {"right": case.front.x1 - edge}
            solids += shelves(rng, replace(whole, **room), 4)
            solids += fixed_fronts(closed, replace(whole, **room).mouth)
    low, high = mouth.x0 - wall * bool(beside[0]), mouth.x1
    if stack[0]:
        solids.append(box((low, mouth.y0 - wall, back), (high, mouth.y0, 0.0)))
        solids += fixed_fronts(closed, Rect(low, high, inner.y0, mouth.y0 - wall))
    if stack[1]:
        solids.append(box((low, mouth.y1, back), (high, mouth.y1 + wall, 0.0)))
        solids += fixed_fronts(closed, Rect(low, high, mouth.y1 + wall, inner.y1))
    return solids
