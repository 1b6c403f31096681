"""Random jars and flasks with a screw lid. What is round shows no turn: bodies have a handle, a spout or a flat side,
and lids a grip."""

import numpy as np

from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category

from ..shapes import JointedParts, box, cylinder, points, tube
from ..vocabulary.vessels import Outline, turned


def generate(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
    """One jar, screwed shut. It stands on y = 0, its axis at x = z = 0; the handle or spout is at -x."""
    radius = rng.uniform(0.035, 0.075)
    tall = radius * rng.uniform(1.7, 3.6)
    mouth = radius * rng.uniform(0.55, 0.95)
    neck, wall = rng.uniform(0.022, 0.03), rng.uniform(0.0015, 0.005)
    shoulder = tall - neck - max(0.0, radius - mouth) * rng.uniform(0.4, 1.2)
    body = _body(rng, radius, mouth, shoulder, tall, neck, wall)
    lid_wall, hat = rng.uniform(0.001, 0.003), rng.uniform(0.002, 0.012)
    skirt = neck * rng.uniform(0.5, 0.8)
    outer = mouth + 0.001 + lid_wall
    edge = rng.uniform(0.85, 1.0)
    lid = [_closed_lid(outer, mouth, edge, tall, skirt, hat), *_grip(rng, outer, tall - skirt, tall + hat)]
    return JointedParts((merge_meshes(body), merge_meshes(lid)), np.zeros((1, 3)))


def _closed_lid(outer: float, mouth: float, edge: float, tall: float, skirt: float, hat: float) -> Mesh:
    """A cap that is open below."""
    inside = mouth + 0.001
    profile = [(0.4 * outer, tall + hat), (edge * outer, tall + hat), (outer, tall + 0.7 * hat), (outer, tall - skirt)]
    return turned([*profile, (inside, tall - skirt), (inside, tall + 0.0006), (0.4 * inside, tall + 0.0006)], 28)


def _body(rng: np.random.Generator, radius, mouth, shoulder, tall, neck, wall) -> list[Mesh]:
    """Round, or square below the shoulder; hollow; with what tells its front."""
    foot = rng.uniform(0.8, 1.0)
    belly = rng.uniform(0.9, 1.0)
    if rng.random() < 0.35:  # square
        outline = Outline(2 * radius, 2 * radius * rng.uniform(0.7, 1.0), rng.uniform(0.2, 0.5))
        low = [outline.plate(0.0, shoulder)]
        low.append(
            turned(
                [
                    (0.95 * mouth, shoulder - 0.001),
                    (mouth, tall - neck),
                    (mouth, tall),
                    (mouth - wall, tall),
                    (mouth - wall, shoulder + 0.002),
                ],
                28,
            )
        )
        low.append(
            outline.dome(shoulder - 0.0005, max(tall - neck - shoulder, 0.003), -0.001, min(0.9, mouth / radius))
        )
        wide = radius
    else:
        s = np.linspace(0.0, 1.0, 5)
        side = [(radius * (foot + (1 - foot) * u) * (belly + (1 - belly) * np.sin(np.pi * u)), shoulder * u) for u in s]
        outside = [*side, (mouth, tall - neck + 1e-4), (mouth, tall)]
        inside = [(max(r - wall, 0.5 * r), max(y, 0.004)) for r, y in outside[::-1]]
        low = [turned([*outside, *inside], 28)]
        wide = radius * (0.5 + 0.5 * foot)
    return [*low, *_sign(rng, wide, radius, shoulder)]


def _sign(rng: np.random.Generator, wide: float, radius: float, shoulder: float) -> list[Mesh]:
    """A handle, a lug or a spout at -x."""
    thick, reach = rng.uniform(0.004, 0.009), radius * rng.uniform(0.4, 0.9)
    low, high = shoulder * rng.uniform(0.1, 0.35), shoulder * rng.uniform(0.65, 0.95)
    kind = rng.random()
    if kind < 0.6:
        s = np.linspace(-1, 1, 11)
        out = 0.85 * wide + (reach + 0.15 * wide) * (1 - np.abs(s) ** rng.uniform(2.0, 6.0))
        return [tube(points(-out, (low + high) / 2 + s * (high - low) / 2, 0.0), thick)]
    if kind < 0.8:
        return [box((-wide - 0.6 * reach, low, -thick), (-0.8 * wide, high, thick))]
    tip = np.array([-wide - 0.8 * reach, high + 0.2 * reach, 0.0])
    return [cylinder((-0.7 * wide, 0.75 * high, 0.0), tip, rng.uniform(0.008, 0.014), 12)]


def _grip(rng: np.random.Generator, outer: float, low: float, top: float) -> list[Mesh]:
    """A bar across the lid, a wing at its side, or a cup's handle; and ribs."""
    solids: list[Mesh] = []
    tall, thick = rng.uniform(0.006, 0.02), rng.uniform(0.002, 0.006)
    kind = rng.random()
    if kind < 0.45:
        half = outer * rng.uniform(0.5, 0.95)
        shift = rng.uniform(0.0, 0.4) * outer
        solids.append(box((-half + shift, top - 0.001, -thick), (min(half + shift, 0.97 * outer), top + tall, thick)))
    elif kind < 0.8:
        end = outer + rng.uniform(0.006, 0.02)
        solids.append(box((0.9 * outer, max(low, top - tall), -1.5 * thick), (end, top, 1.5 * thick)))
    else:
        s = np.linspace(-1, 1, 9)
        arch = points(s * 0.6 * outer, top - 0.002 + 1.6 * tall * (1 - np.abs(s) ** 3), 0.2 * outer)
        solids.append(tube(arch, thick))
    if rng.random() < 0.5:
        for angle in np.arange(12) * np.pi / 6:
            x, z = outer * np.cos(angle), outer * np.sin(angle)
            solids.append(cylinder((x, low + 0.001, z), (x, top - 0.003, z), 0.0012, 6))
    return solids
