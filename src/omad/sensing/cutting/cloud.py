"""A cloud as it is cut: where its points are, and in which cell of the image."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from omad.common.compiled import jit

ENOUGH = 40_000
"""Points, at most, for what is the same with more of them: a plane fitted to them, the median of their distances."""
CELLS = 160
"""Across the frame; heights over a plane are averaged inside such a cell, against the noise of single pixels."""
BORDER = 0.02
"""So near to the frame's border, as a share of half its size, a point is at it."""
COARSE, FINE = 0.01, 0.002
"""Thickness of a plane as a share of the distance: while searching, and at least when done (depth noise widens it)."""
FAR = 4.0
"""From so many times the middle distance on, errors are taken to grow no more: of a stray number at the end of a
camera's range hardly a plane would be farther away."""


@dataclass(frozen=True)
class Frame:
    """What of a plane points span, but for single ones beside all others: places in it are -1 to 1."""

    low: np.ndarray
    """(2, 1) float32."""
    steps: np.ndarray
    """(2, 1) float32, of places for one of the plane's unit."""

    @classmethod
    def of(cls, seen: np.ndarray) -> Self:
        """Of points (2, N)."""
        few = some_of(seen) if seen.size else np.zeros((2, 1))
        low, high = np.quantile(few, (0.001, 0.999), axis=1)[..., None]
        return cls(low.astype(np.float32), (2 / np.maximum(high - low, 1e-9)).astype(np.float32))

    def places(self, points: np.ndarray) -> np.ndarray:
        """(2, N) in the frame, of points (2, N); those beside it are at its border."""
        return np.clip((points - self.low) * self.steps - np.float32(1), -1, 1)


@dataclass(frozen=True)
class Cloud:
    """N points in the camera frame, by columns."""

    points: np.ndarray
    """(3, N) float32 metres."""
    frame: Frame
    """Of the image, what rays x / z and y / z to the points span."""
    at_border: np.ndarray
    """(N,) bool, which of them are within ``BORDER`` of the frame's."""
    cell: np.ndarray
    """(N,) int32 number of the image cell, of ``(CELLS + 1)**2``."""
    scale: np.ndarray
    """(N,) float32 metres that heights over a plane are measured in: the errors of stereo grow with the square of the
    distance, and it is that at the ``middle`` one."""
    middle: float
    """Metres; median of the distances."""

    @classmethod
    def of(cls, points: np.ndarray) -> Self:
        """Of points (N, 3)."""
        columns = np.ascontiguousarray(points.T, dtype=np.float32)
        few = some_of(columns)
        frame, middle = Frame.of(_rays(few)), float(np.median(distances(few))) if few.size else 0.0
        limits = np.float32(FAR * middle), np.float32(max(middle, 1e-9))
        at_border, cell, scale = _measured(columns, frame.low, frame.steps, *limits)
        return cls(columns, frame, at_border, cell, scale, middle)

    def part(self, index: np.ndarray) -> Self:
        """Some of its points, in the same frame and scale."""
        points, at_border = self.points.take(index, 1), self.at_border[index]
        return type(self)(points, self.frame, at_border, self.cell[index], self.scale[index], self.middle)

    def places(self, index: np.ndarray) -> np.ndarray:
        """(2, M) float32 where some of its points are in the frame, -1 to 1."""
        return self.frame.places(_rays(self.points.take(index, 1)))

    def heights(self, plane: np.ndarray) -> tuple[np.ndarray, float]:
        """(N,) over a ``plane`` (4,) n . p = d as a share of ``scale``, averaged near it over each image cell; and the
        plane's half thickness."""
        height = _heights(self.points, plane.astype(np.float32), self.scale)
        _average(height, self.cell, np.float32(max(COARSE, 3 * scatter(some_of(height)))))
        return height, thickness(some_of(height))


def every(count: int) -> int:
    """Of so many values one in how many makes at most ``ENOUGH``, evenly. An odd step meets all columns of most
    images."""
    return -(-count // ENOUGH) | 1


def some_of(values: np.ndarray) -> np.ndarray:
    """At most ``ENOUGH`` of values (..., N)."""
    return values[..., :: every(values.shape[-1])]


def distances(points: np.ndarray) -> np.ndarray:
    """(N,) metres from the camera, of points (3, N)."""
    return np.sqrt(np.einsum("an,an->n", points, points))


def thickness(height: np.ndarray) -> float:
    """Half thickness of a plane, from the scatter of the points on it; all relative."""
    return float(np.clip(3 * scatter(height), FINE, COARSE))


def scatter(height: np.ndarray) -> float:
    """Standard deviation of the heights of points on a plane, those within ``COARSE``."""
    height = np.abs(height)
    near = height[height < COARSE]
    return 1.4826 * float(np.median(near)) if len(near) else 0.0


def _rays(points: np.ndarray) -> np.ndarray:
    """(2, N) x / z and y / z, of points (3, N)."""
    return points[:2] / np.maximum(points[2], np.float32(1e-9))


@jit
def _measured(points, low, steps, far, middle):
    """Of points (3, N), as a ``Cloud`` has them: ``at_border``, ``cell`` and ``scale``."""
    count = points.shape[1]
    at_border, cell = np.empty(count, dtype=np.bool_), np.empty(count, dtype=np.int32)
    scale = np.empty(count, dtype=np.float32)
    left, top, by_x, by_y = low[0, 0], low[1, 0], steps[0, 0], steps[1, 0]
    one, border, least = np.float32(1), np.float32(1 - BORDER), np.float32(1e-9)
    for i in range(count):
        x, y, z = points[0, i], points[1, i], points[2, i]
        before = max(z, least)
        across = min(max((x / before - left) * by_x - one, -one), one)
        down = min(max((y / before - top) * by_y - one, -one), one)
        at_border[i] = (abs(across) > border) | (abs(down) > border)
        cell[i] = np.int32((across + 1) * (CELLS / 2)) * (CELLS + 1) + np.int32((down + 1) * (CELLS / 2))
        distance = min(np.sqrt(x * x + y * y + z * z), far)
        scale[i] = distance * distance / middle
    return at_border, cell, scale


@jit
def _heights(points, plane, scale):
    """(N,) float32, of points (3, N) over a plane (4,), in their ``scale`` (N,)."""
    height = np.empty_like(scale)
    a, b, c, d = plane
    for i in range(len(height)):
        height[i] = (a * points[0, i] + b * points[1, i] + c * points[2, i] - d) / scale[i]
    return height


@jit
def _average(height, cell, reach):
    """Of heights (N,) those within ``reach`` become the mean of these in their ``cell`` (N,)."""
    total, count = np.zeros((CELLS + 1) ** 2), np.zeros((CELLS + 1) ** 2)
    at, of_cell, in_cell = 0, 0.0, 0.0  # neighbours mostly share a cell: its sums are not stored after each of them
    for i in range(len(height)):
        if abs(height[i]) < reach:
            if cell[i] != at:
                total[at], count[at] = of_cell, in_cell
                at = cell[i]
                of_cell, in_cell = total[at], count[at]
            of_cell += height[i]
            in_cell += 1
    total[at], count[at] = of_cell, in_cell
    mean = (total / count).astype(np.float32)
    for i in range(len(height)):
        if abs(height[i]) < reach:
            height[i] = mean[cell[i]]
