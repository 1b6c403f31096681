"""Random staplers: a base, a lid hinged at its back, and a magazine that swings out of the lid."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import (
    JointedParts,
    X,
    box,
    cylinder,
    ellipse,
    hexahedron,
    points,
    rounded_rectangle,
    slab,
    spline,
    sweep,
    taper,
)


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One stapler, shut, whose base stands on y = 0; the front is at +z. Lid and magazine are parallel to the base, or
    come down to it at the front, the magazine by more. Unusual ones have a lid that is round at both ends and hides
    the hinge, or long cheeks; a plate that stands out; a magazine like a wedge."""
    length, width = rng.uniform(0.1, 0.19), rng.uniform(0.02, 0.042)
    plate, gap = rng.uniform(0.003, 0.014), rng.choice([rng.uniform(0.0005, 0.004), rng.uniform(0.002, 0.012)])
    tall = rng.uniform(0.006, rng.choice([0.013, 0.02]))  # of the magazine
    cover = rng.uniform(0.008, 0.024)  # of the lid
    back, front = -length / 2, length / 2
    inside = width * rng.uniform(0.5, 0.8)
    leans, dips = rng.choice([0.0, rng.uniform(0.0, 0.08)]), rng.choice([0.0, rng.uniform(0.0, 0.13)])
    if unusual:
        leans = unusual.uniform(0.0, 0.08)
    low = plate + gap + 0.85 * length * (leans + dips)
    hinge_y = low + tall * rng.uniform(0.2, 1.2)
    hinge_z = back + length * rng.uniform(0.03, 0.12)
    hidden = bool(unusual and unusual.random() < 0.6)  # the hinge, by the lid
    if hidden:
        hinge_y = min(hinge_y, low + 0.9 * tall)
    base = _plate(rng, width, length, plate, unusual)
    base += _cheeks(rng, width, length, plate, low, hinge_y, hinge_z, unusual, inside / 2 if hidden else None)
    start = hinge_z + rng.choice([0.0, rng.uniform(0.0, 0.3), rng.uniform(0.15, 0.4)]) * length
    if rng.random() < 0.35 and start > hinge_z + 0.01:  # a block between the cheeks, behind the magazine
        clear = hinge_z + max(hinge_y - low - tall, 0.0)  # of the lid that is open
        base.append(box((-0.47 * inside, 0.5 * plate, clear), (0.47 * inside, low + 0.9 * tall, start - 0.001)))

    reach = length * rng.uniform(0.86, 1.05)
    ahead = min(hinge_z + reach, front + 0.006)
    sunk = tall * rng.uniform(0.0, 0.7)  # how far the lid comes down beside the magazine
    wall = 0.5 * (width * rng.uniform(0.85, 1.0) - inside)
    tail = hinge_z - rng.uniform(0.2, 0.9) * min(hinge_z - back, max(hinge_y - plate, 0.001))  # comes down behind
    cover = max(cover, 0.42 * (start - tail) - tall + sunk)  # a magazine that is at its front still lies below it
    top, sill = low + tall + cover, low + tall - sunk
    lid = _lid(rng, inside + 2 * wall, low + tall + 0.0004, top, tail, ahead, unusual if hidden else None)
    for inner, outer in (
        (0.5 * inside + 0.1 * wall, 0.5 * inside + wall),
        (-0.5 * inside - wall, -0.5 * inside - 0.1 * wall),
    ):
        lid.append(box((inner, sill, tail), (outer, low + tall + 0.002, 0.9 * ahead)))

    end = ahead - rng.uniform(0.0, 0.06) * length
    magazine = _magazine(rng, 0.46 * inside, low, tall, start, end, 0.3 * gap, unusual)
    pin = cylinder((-0.5 * inside - wall, hinge_y, hinge_z), (0.5 * inside + wall, hinge_y, hinge_z), 0.0012, 8)
    hinge, second = np.array([0.0, hinge_y, hinge_z]), np.array([0.0, low + 0.5 * tall, max(start, hinge_z)])
    pivot = second if rng.random() < 0.65 else hinge
    dip, lean = _lowering(pivot, dips), _lowering(hinge, leans)
    parts = merge_meshes(base), merge_meshes([*lid, pin]).warped(lean), merge_meshes(magazine).warped(dip).warped(lean)
    return JointedParts(parts, np.stack([hinge, lean(pivot)]))


def _lowering(pivot: np.ndarray, angle: float) -> Callable[[np.ndarray], np.ndarray]:
    """Turns points so that the front comes down."""
    return lambda points: Rotation.from_rotvec([angle, 0.0, 0.0]).apply(points - pivot) + pivot


def _magazine(rng: np.random.Generator, half, low, tall, start, end, lip, unusual) -> list[Mesh]:
    """A channel that is open above, empty or filled; or a wedge."""
    top, side = low + tall, 0.0012
    if unusual and unusual.random() < 0.5:
        high, thin = [[-half, top], [half, top]], top - tall * unusual.uniform(0.05, 0.6)
        ends = [[[-half, y], [half, y], *high[::-1]] for y in (thin, low)]
        return [hexahedron(np.concatenate([np.insert(ends[0], 2, start, 1), np.insert(ends[1], 2, end, 1)]))]
    magazine = [box((-half, low, start), (half, low + side, end)), box((-half, low, end - side), (half, top, end))]
    magazine += [box((s * half - side / 2, low, start), (s * half + side / 2, top, end)) for s in (-1, 1)]
    if rng.random() < 0.5:  # filled
        magazine.append(box((-0.9 * half, low, start), (0.9 * half, low + 0.8 * tall, end - 0.3 * (end - start))))
    if rng.random() < 0.5:  # where staples leave it
        magazine.append(box((-0.9 * half, low - lip, end - 0.008), (0.9 * half, top, end)))
    return magazine


def _plate(rng: np.random.Generator, width, length, plate, unusual) -> list[Mesh]:
    """What lies on the table, flat or wedge-shaped or round at its ends, with an anvil."""
    z = np.linspace(-length / 2, length / 2, 10)
    u = np.abs(2 * z / length) ** rng.uniform(4.0, 12.0)
    wide = width * (1 - rng.uniform(0.0, 0.5) * u)
    tall = plate * np.linspace(1.0, rng.uniform(0.5, 1.0), 10)
    path = points(0.0, tall / 2, z)
    solids = [sweep(path, np.cross([0, 0, 1.0], X), taper(rounded_rectangle(1.0, 1.0, 0.15, 2), wide, tall))]
    if unusual:
        x, round_ = 0.5 * width * unusual.uniform(1.0, 1.4), unusual.uniform(0.0, 0.3) * width
        high = (x, plate * unusual.uniform(0.8, 1.0), length / 2)
        solids.append(slab((-x, 0.0, -length / 2), high, 1, round_, plate * unusual.uniform(0.0, 0.4)))
    at = length * rng.uniform(0.36, 0.44)
    return [*solids, box((-0.3 * width, 0.3 * plate, at - 0.008), (0.3 * width, plate * 0.9 + 0.001, at + 0.005))]


def _cheeks(
    rng: np.random.Generator, width, length, plate, low, hinge_y, hinge_z, unusual, hidden: float | None
) -> list[Mesh]:
    """What holds the hinge, beside the lid, short, or long and upright or sloping in front; or ``hidden`` in the lid,
    so far from the middle; and a spring under the magazine."""
    outer, thick = 0.5 * width + 0.0015, rng.uniform(0.0008, 0.002)
    long, slope = rng.uniform(0.006, 0.016), hinge_z + rng.choice([0.0, rng.uniform(0.15, 0.5)]) * length
    reach = hinge_z + length * unusual.uniform(0.05, 0.4) if unusual else slope
    if hidden:  # below the lid, and before it where it is open
        cheek = box((0.94 * hidden, 0.4 * plate, hinge_z), (hidden, hinge_y, reach))
        return [cheek, cheek.mirrored()]
    solids = []
    for s in (-1, 1):
        x = s * outer
        solids.append(
            box(
                (min(x, x + s * thick), 0.4 * plate, hinge_z - long),
                (max(x, x + s * thick), hinge_y + 0.003, hinge_z + long),
            )
        )
        if reach > hinge_z:  # down towards the front
            tip = hinge_y + 0.002 if unusual else 0.9 * plate
            ring = [[x, 0.4 * plate, hinge_z], [x, hinge_y + 0.002, hinge_z], [x, tip, reach], [x, 0.4 * plate, reach]]
            solids.append(hexahedron(np.concatenate([ring, ring + s * thick * X])))
    solids.append(box((-outer - thick, 0.2 * plate, hinge_z - long), (outer + thick, 0.7 * plate, hinge_z + long)))
    if rng.random() < 0.4:
        x = 0.2 * width
        solids.append(
            box((-x, 0.5 * plate, hinge_z + long), (x, plate + 0.3 * (low - plate), hinge_z + long + 0.2 * length))
        )
    return solids


def _lid(rng: np.random.Generator, width, low, top, tail, ahead, blunt) -> list[Mesh]:
    """A bar that is arched from back to front, or ``blunt`` at both ends, round or angular in section."""
    z = np.linspace(tail, ahead, 14)
    u = np.linspace(0.0, 1.0, 14)
    rise = spline(
        [[0.0, rng.uniform(0.4, 0.9)], [0.5, rng.uniform(0.75, 1.0)], [0.85, 1.0], [1.0, rng.uniform(0.3, 0.9)]], 14
    )[:, 1]
    wide = width * (1 - rng.uniform(0.0, 0.4) * u ** rng.uniform(3.0, 10.0))
    if blunt:
        power = blunt.uniform(3.0, 14.0)
        u = (1 - np.cos(np.pi * u)) / 2  # closer together at the ends
        z, wide = tail + u * (ahead - tail), width * blunt.uniform(1.0, 1.15)
        lower = 1 - blunt.uniform(0.0, 0.2) * np.abs(blunt.choice([0.0, 1.0]) - u)  # towards one end
        rise = lower * (1 - np.abs(2 * u - 1) ** power) ** (1 / power)
    high = (top - low) * np.clip(rise, 0.25, 1.0)
    section = rounded_rectangle(1.0, 1.0, rng.uniform(0.05, 0.45), 3) if rng.random() < 0.8 else ellipse(0.55, 0.5, 14)
    path = points(0.0, low + high / 2, z)
    solid = sweep(points(0.0, 0.0, z), np.array([0.0, 1.0, 0.0]), taper(section, wide, high))
    lift = np.repeat(path[:, 1], len(section))
    lift = np.concatenate([lift, [path[0, 1], path[-1, 1]]])
    return [solid.warped(lambda vertices: vertices + points(0.0, lift, 0.0))]
