"""Bodies that are open above, and their lids: of boxes, bins, buckets, jars."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from omad.geometry.mesh import Mesh

from ..shapes import loft, points, rounded_rectangle


@dataclass(frozen=True)
class Outline:
    """What a body is like from above: a rectangle around the origin with round corners, up to a disc."""

    width: float
    depth: float
    corner: float
    """Radius as a share of half the shorter side: 1 is a disc, or the outline of a running track."""
    fillet: float = 0.0
    """Radius at which the sides of a shell turn into its floor; less in one that is not so tall."""

    def ring(self, y: float, grown: float = 0.0, scale: float = 1.0) -> np.ndarray:
        """(n, 3) points at height ``y``, each side moved out by ``grown`` after scaling."""
        width, depth = self.width * scale + 2 * grown, self.depth * scale + 2 * grown
        radius = self.corner * min(width, depth) / 2
        x, z = rounded_rectangle(width, depth, radius, 6 if self.corner > 0.6 else 3).T
        return points(x, y, z)

    def plate(self, y0: float, y1: float, grown: float = 0.0, scale: float = 1.0) -> Mesh:
        """Solid between two heights."""
        return loft(np.stack([self.ring(y0, grown, scale), self.ring(y1, grown, scale)]))

    def shell(self, foot: float, rim: float, wall: float, floor: float, flare: float = 1.0) -> Mesh:
        """Hollow and open at height ``rim``, with a floor at ``foot``, where its outline is ``flare`` times as large; a
        lid turned upside down where the rim is below the foot."""
        up = 1.0 if rim > foot else -1.0
        share = floor / abs(rim - foot)
        inner = flare + (1 - flare) * share
        outside = min(self.fillet, 0.9 * abs(rim - foot))
        inside = max(outside - wall, 0.0)
        turns = np.linspace(0.0, np.pi / 2, 4) if outside else [np.pi / 2]
        rings = [self.ring(foot + up * outside * (1 - np.cos(t)), -outside * (1 - np.sin(t)), flare) for t in turns]
        rings += [self.ring(rim), self.ring(rim, -wall)]
        for t in turns[::-1] if inside else [np.pi / 2]:
            rise = max(floor, outside - inside * np.cos(t))
            rings.append(self.ring(foot + up * rise, -wall - inside * (1 - np.sin(t)), inner))
        return loft(np.stack(rings))

    def hoop(self, y0: float, y1: float, inside: float, outside: float) -> Mesh:
        """A band around it between two heights, from ``inside`` within its outline to ``outside``."""
        edges = ((y0, outside), (y1, outside), (y1, -inside), (y0, -inside))
        return loft(np.stack([self.ring(y, grown) for y, grown in edges]), closed=True)

    def dome(self, y: float, rise: float, grown: float = 0.0, flat: float = 0.3) -> Mesh:
        """Solid with a flat underside at ``y`` that bulges up to ``rise`` above, where ``flat`` of it is level."""
        angle = np.linspace(0.0, np.pi / 2, 6)
        scales = flat + (1 - flat) * np.cos(angle)
        scales[-1] = max(scales[-1], 0.05)
        heights = y + 0.15 * rise + 0.85 * rise * np.sin(angle)
        return loft(np.stack([self.ring(y, grown), *map(self.ring, heights, [grown] * 6, scales)]))


def turned(profile: Sequence[tuple[float, float]] | np.ndarray, segments: int = 24) -> Mesh:
    """Solid of revolution about y through a profile of (radius, height), which may run up outside and down inside."""
    angle = np.arange(segments) * 2 * np.pi / segments
    return loft(np.stack([points(r * np.cos(angle), y, r * np.sin(angle)) for r, y in profile]))


@dataclass(frozen=True)
class Lid:
    """A lid that is shut, and where it may be hinged."""

    solids: list[Mesh]
    hinge: float
    """Height of a hinge at the back at which nothing jams."""
    behind: float
    """How far such a hinge is behind the body, at least."""
    top: float


def lid(rng: np.random.Generator, outline: Outline, rim: float, wall: float, tall: float) -> Lid:
    """A lid on a body whose outline at the height ``rim`` is ``outline``, ``tall`` at most: a plate that may stand over
    the rim or carry a field, a turned-over tray that meets the rim or laps over it, or a dome."""
    kind, over = rng.random(), rng.choice([0.0, rng.uniform(0.0, 0.06)]) * outline.width
    thick = max(wall * rng.uniform(0.6, 1.6), 0.0015)
    seat = rim + 0.0008
    if kind < 0.4:
        solids, top = [outline.plate(seat, seat + thick, over)], seat + thick
        if rng.random() < 0.4:
            top += rng.uniform(0.1, 0.6) * tall
            solids.append(outline.plate(seat + thick, top, over, rng.uniform(0.6, 0.92)))
        if rng.random() < 0.4:  # a lip that holds it in place
            lip = min(0.4 * tall, 0.08 * outline.depth, 0.03)
            solids.append(outline.plate(rim - lip, seat + 1e-4, -wall - max(0.004, lip**2 / outline.depth)))
        return Lid(solids, seat + thick * rng.uniform(0.0, 0.5), over, top)
    if kind < 0.8:
        lap = rng.uniform(0.1, 0.5) * tall if rng.random() < 0.4 else 0.0
        over = thick + 0.001 if lap else 0.0
        size = replace(outline, width=outline.width + 2 * over, depth=outline.depth + 2 * over)
        top = seat + tall * rng.uniform(0.35, 1.0) + thick
        solids = [size.shell(top, seat - lap, thick, thick, rng.choice([1.0, rng.uniform(0.8, 1.0)]))]
        return Lid(solids, seat - lap, over, top)
    rise = tall * rng.uniform(0.4, 1.0)
    return Lid([outline.dome(seat, rise, over, rng.uniform(0.0, 0.6))], seat, over, seat + rise)
