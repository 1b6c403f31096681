"""Random washing machines and dryers: a box with a round door in its front and a drum behind it."""

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder, loft, points, rounded_rectangle, sides, slab
from ..vocabulary.cases import Rect, controls
from ..vocabulary.handles import handle
from ..vocabulary.stands import feet

SEGMENTS = 28


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One machine, shut, its door hinged at the left. Body on y = 0 .. height, its front plane at z = 0."""
    width = rng.uniform(0.45, 0.72)
    height, depth = width * rng.uniform(1.15, 1.7), width * rng.uniform(0.6, 1.3)
    radius = width * rng.uniform(0.24, 0.42)  # of the door
    mouth = radius * rng.uniform(0.65, 0.92)
    middle = np.array([width * rng.choice([0.0, rng.uniform(-0.05, 0.05)]), height * rng.uniform(0.42, 0.56)])
    crude = rng.random() < 0.12
    if crude:
        body = [box((-width / 2, 0, -depth), (width / 2, height, 0))]
    else:
        body = _body(rng, width, height, depth, middle, mouth)
    low = height * rng.uniform(0.8, 0.9)
    strip = Rect(-width / 2, width / 2, max(low, middle[1] + radius + 0.02), height)
    reach = rng.choice([0.002, rng.uniform(0.002, 0.03)])
    body += [strip.slab(-0.004, reach), *controls(rng, strip.grown(-0.03, -0.15 * strip.height), reach, 7)]
    if rng.random() < 0.5:  # the soap drawer
        half = strip.height * rng.uniform(0.3, 0.45)
        x0, y = -width / 2 + rng.uniform(0.01, 0.03), strip.centre[1]
        body.append(box((x0, y - half, -0.003), (x0 + width * rng.uniform(0.2, 0.3), y + half, reach + 0.006)))
    if rng.random() < 0.5:
        body.append(slab((-width / 2, height, -depth), (width / 2, height + 0.02, reach), 1, 0.004))
    if rng.random() < 0.5:  # the flap below
        x = width * rng.uniform(0.1, 0.35)
        body.append(box((x - 0.06, 0.02, -0.003), (x + 0.06, 0.02 + 0.08 * height, 0.004)))
    body += feet(rng, width / 2, depth, 0.05)

    thickness = rng.uniform(0.02, 0.08)
    moving = _door(rng, middle, radius, mouth, thickness, rng.uniform(0.3, 1.0) if rng.random() < 0.2 else 0.0)
    if not crude and rng.random() < 0.75:
        moving.append(_glass(rng, middle, mouth, radius))
    if rng.random() < 0.5:
        a = 0.7 * radius
        moving += handle(rng, Rect(middle[0] - a, middle[0] + a, middle[1] - a, middle[1] + a), thickness, "right", 0.4)
    arm = rng.uniform(0.0, 0.06) * radius
    pivot = np.array([middle[0] - radius - arm, 0.0, thickness * rng.uniform(0.4, 1.0)])
    half = radius * rng.uniform(0.1, 0.25)
    y = middle[1]
    moving.append(
        box((pivot[0], y - half, 0.2 * thickness), (pivot[0] + 0.35 * radius + arm, y + half, 0.8 * thickness))
    )
    return JointedParts((merge_meshes(body), merge_meshes(moving)), pivot[None])


def _ring(middle: np.ndarray, radius: float, z: float, square: float = 0.0) -> np.ndarray:
    """(n, 3) a circle before the front; or, with ``square`` up to 1, nearly a square with round corners."""
    size = 2 * radius
    outline = rounded_rectangle(size, size, radius * (0.99 - 0.7 * square), SEGMENTS // 4 - 1)
    x, y = (outline + middle).T
    return points(x, y, z)


def _body(rng: np.random.Generator, width, height, depth, middle, mouth) -> list[Mesh]:
    """A closed shell around a drum: a front with a round hole, the drum's wall and bottom, and the other walls."""
    wall, deep = 0.02, -depth * rng.uniform(0.55, 0.9)
    angle = np.arctan2(*(_ring(np.zeros(2), 1.0, 0.0)[:, 1::-1]).T)
    reach = np.minimum(
        np.where(np.cos(angle) > 0, width / 2 - middle[0], width / 2 + middle[0])
        / np.maximum(np.abs(np.cos(angle)), 1e-9),
        np.where(np.sin(angle) > 0, height - middle[1], middle[1]) / np.maximum(np.abs(np.sin(angle)), 1e-9),
    )
    edge = points(middle[0] + reach * np.cos(angle), middle[1] + reach * np.sin(angle), 0.0)
    hole = points(middle[0] + mouth * np.cos(angle), middle[1] + mouth * np.sin(angle), 0.0)
    front = loft(np.stack([edge, hole, hole - [0, 0, wall], edge - [0, 0, wall]]), closed=True)
    bends = ((1.0, -wall), (1.12, -wall - 0.05), (1.12, deep), (1.14, deep), (1.14, -wall - 0.045), (1.03, -wall))
    drum = loft(np.stack([_ring(middle, mouth * share, z) for share, z in bends]), closed=True)
    x = width / 2
    inner = x - wall
    shell = [
        *sides((-x, 0, -depth), (x, height, -wall), wall),
        box((-inner, 0, -depth), (inner, wall, -wall)),
        box((-inner, height - wall, -depth), (inner, height, -wall)),
        box((-inner, wall, -depth), (inner, height - wall, deep - wall)),
    ]
    return [front, drum, *shell]


def _door(rng: np.random.Generator, middle, radius, mouth, thickness, square) -> list[Mesh]:
    """A ring with a sunk or bulging pane, or a disc."""
    inner, back = mouth * rng.uniform(0.75, 0.98), 0.0008
    bevel = rng.uniform(0.0, 0.4) * thickness
    edges = ((radius, back), (radius, thickness - bevel), (radius - bevel, thickness))
    rings = [_ring(middle, r, z, square) for r, z in edges]
    if rng.random() < 0.25:
        return [loft(np.stack(rings))]
    inside = [_ring(middle, inner, z) for z in (thickness, back)]
    pane = rng.uniform(0.1, 0.9) * thickness
    return [
        loft(np.stack([*rings, *inside]), closed=True),
        cylinder((*middle, pane - 0.004), (*middle, pane), 1.01 * inner, SEGMENTS),
    ]


def _glass(rng: np.random.Generator, middle: np.ndarray, mouth: float, radius: float) -> Mesh:
    """The bowl of glass that reaches through the mouth; its edge swings in an arc that must stay clear of it."""
    deep = mouth * rng.uniform(0.1, 0.55)
    wide = mouth - 0.008 - 0.35 * deep**2 / radius
    depths = ((0.001, 1.0), (-0.5 * deep, 0.95), (-0.85 * deep, 0.8), (-deep, 0.5))
    return loft(np.stack([_ring(middle, share * wide, z) for z, share in depths]))
