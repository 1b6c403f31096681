"""Random chests of three drawers: with and without legs, overhanging tops, inset or overlaid fronts, trays, pulls."""

from itertools import pairwise

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from .shapes import JointedParts, box, cylinder, posts, sides, slab


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One chest, all drawers closed. Body on y = 0 .. height, its front plane at z = 0, the room at +z."""
    width = rng.uniform(0.28, 0.85)
    height = rng.uniform(0.3, 0.9)
    depth = rng.uniform(0.26, 0.55)
    wall = rng.uniform(0.01, 0.035)
    base = rng.choice([0.0, rng.uniform(0.02, 0.1), rng.uniform(0.05, 0.25) * height])
    thickness = rng.uniform(0.012, 0.035)
    inset = rng.random() < 0.45
    front = rng.uniform(0.0, 0.005) if inset else thickness  # plane of the drawers' faces

    low, high = base + wall, height - wall
    shares = rng.uniform(0.6, 1.4, 3) if rng.random() < 0.6 else np.ones(3)
    edges = high - (high - low) * np.concatenate([[0.0], np.cumsum(shares / shares.sum())])
    cabinet = _cabinet(rng, width, height, depth, wall, base, edges)
    pull = _Pull(rng, unusual)
    fill = rng.uniform(0.4, 0.9) if rng.random() < 0.2 else 1.0  # trays leave their bays open above
    drawers = []
    for top, bottom in pairwise(edges):
        gap = rng.uniform(0.001, 0.004)
        half = width / 2 - wall - gap if inset else width / 2 - rng.uniform(0.0, 0.004)
        spill = -gap if inset else wall * 0.45 - gap
        top = bottom + fill * (top - bottom)
        face_low, face_high = bottom - spill, top + spill
        solids = [slab((-half, face_low, front - thickness), (half, face_high, front), 2, 0.002, pull.bevel)]
        solids += _open_box(rng, width / 2 - wall - 0.012, bottom, top, depth, wall, front - thickness)
        solids += pull.solids(half, face_low, face_high, front)
        drawers.append(merge_meshes(solids))
    limits = np.tile([0.0, 0.6 * depth], (3, 1))
    return JointedParts((merge_meshes(cabinet), *drawers), np.zeros((3, 3)), limits=limits)


def _cabinet(rng, width, height, depth, wall, base, edges) -> list[Mesh]:
    """Walls, back, bottom, top, rails between the drawers, and what it stands on."""
    x, inner = width / 2, width / 2 - wall
    over, side = rng.choice([0.0, rng.uniform(0.005, 0.04)]), rng.choice([0.0, rng.uniform(0.005, 0.03)])
    bottomless = rng.random() < 0.15  # two sides that stand on the floor, nothing below the last drawer
    foot = 0.0 if bottomless else base
    solids = [
        *sides((-x, foot, -depth), (x, height, 0), wall),
        box((-inner, foot, -depth), (inner, height, -depth + wall * rng.uniform(0.3, 1.0))),
        slab((-x - side, height - wall, -depth), (x + side, height + rng.uniform(0.0, 0.02), over), 1, 0.004),
    ]
    if rng.random() < 0.5:
        solids += [box((-inner, y - 0.3 * wall, -depth * 0.9), (inner, y + 0.3 * wall, -0.002)) for y in edges[1:-1]]
    if bottomless:
        return solids
    solids.append(box((-inner, base, -depth + wall), (inner, base + wall, 0)))
    return solids + (_stand(rng, x, depth, base) if base > 0.015 else [])


def _stand(rng, x: float, depth: float, base: float) -> list[Mesh]:
    """Four legs, straight or round; two runners; or a plinth."""
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


def _open_box(rng, half, bottom, top, depth, wall, back_of_face) -> list[Mesh]:
    """The drawer behind its face: two sides, bottom, back, open above."""
    deep, side = (depth - wall) * rng.uniform(0.78, 0.99), rng.uniform(0.006, 0.015)
    low, high = bottom + 0.25 * wall + 0.004, top - (top - bottom) * rng.uniform(0.08, 0.4)
    inner = half - side
    return [
        *sides((-half, low, -deep), (half, high, back_of_face), side),
        box((-inner, low, -deep), (inner, high, -deep + side)),
        box((-inner, low, -deep + side), (inner, low + side, back_of_face)),
    ]


class _Pull:
    """The kind of handle, the same on all drawers of a chest."""

    def __init__(self, rng: np.random.Generator, unusual: np.random.Generator | None) -> None:
        self.kind = rng.random()
        self.pair = rng.random() < 0.35
        self.size, self.reach = rng.uniform(0.008, 0.02), rng.uniform(0.015, 0.05)
        self.span, self.height = rng.uniform(0.1, 0.45), rng.uniform(0.3, 0.85)
        self.bevel = rng.uniform(0.0, 0.004)
        if unusual:  # a bar, or a ledge, across nearly all of the face
            self.kind, self.pair = unusual.uniform(0.4, 0.9), False
            self.span, self.reach = unusual.uniform(0.5, 0.97), unusual.uniform(0.02, 0.08)
            self.size *= unusual.uniform(1.0, 2.0)

    def solids(self, half: float, low: float, high: float, front: float) -> list[Mesh]:
        """Handles on a face that spans x = -half .. half, y = low .. high at z = front."""
        if self.kind < 0.12:
            return []  # pushed open, or gripped at its edge
        y, root = low + self.height * (high - low), front - 0.002
        centres = (-0.5 * half, 0.5 * half) if self.pair and half > 0.25 else (0.0,)
        solids = []
        span, tip, g = self.span * half / len(centres), front + self.reach, 0.5 * self.size
        for x in centres:
            if self.kind < 0.4:
                solids.append(cylinder((x, y, root), (x, y, tip), self.size, 12))
            elif self.kind < 0.8:
                solids += posts(x, y, span, g, root, tip)
                solids.append(slab((x - span - g, y - g, tip - g), (x + span + g, y + g, tip + g), 2, 0.4 * g))
            elif self.kind < 0.9:
                solids.append(box((x - span, y - g, root), (x + span, y + g, front + 0.6 * self.reach)))
            else:
                lip = half * 0.98 / len(centres)
                solids.append(box((x - lip, high - 1.5 * g, root), (x + lip, high, front + 0.5 * self.reach)))
        return solids
