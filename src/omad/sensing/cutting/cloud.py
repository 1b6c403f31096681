"""A cloud as it is cut: where its points are, how far away, and in which cell of the image."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from omad.common.compiled import jit

ENOUGH = 40_000
"""Points, at most, for what is the same with more of them: a plane fitted to them, the median of their distances."""
CELLS = 160
"""Across the frame; heights over a plane are averaged inside such a cell, against the noise of single pixels."""
COARSE, FINE = 0.01, 0.002
"""Thickness of a plane as a share of the distance: while searching, and at least when done (depth noise widens it)."""
FAR = 4.0
"""From so many times the middle distance on, errors are taken to grow no more: of a stray number at the end of a
camera's range hardly a plane would be farther away."""


@dataclass(frozen=True)
class Cloud:
    """N points in the camera frame, by columns."""

    points: np.ndarray
    """(3, N) float32 metres."""
    distance: np.ndarray
    """(N,) float32 metres from the camera."""
    place: np.ndarray
    """(2, N) in the frame, -1 to 1; the frame is what the points span."""
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
        distance = np.sqrt(np.einsum("an,an->n", columns, columns))
        rays = columns[:2] / np.maximum(columns[2], np.float32(1e-9))
        place = framed(rays, rays)
        middle = float(np.median(some_of(distance))) if len(distance) else 0.0
        scale = np.minimum(distance, np.float32(FAR * middle)) ** 2 / np.float32(max(middle, 1e-9))
        return cls(columns, distance, place, _cells(place), scale, middle)

    def part(self, index: np.ndarray) -> Self:
        """Some of its points, in the same frame and scale."""
        of_axes = self.points.take(index, 1), self.distance[index], self.place.take(index, 1)
        return type(self)(*of_axes, self.cell[index], self.scale[index], self.middle)

    def heights(self, plane: np.ndarray) -> tuple[np.ndarray, float]:
        """(N,) over a ``plane`` (4,) n . p = d as a share of ``scale``, averaged near it over each image cell; and the
        plane's half thickness."""
        height = _heights(self.points, plane.astype(np.float32), self.scale, self.cell)
        return height, thickness(some_of(height))


def some_of(values: np.ndarray) -> np.ndarray:
    """At most ``ENOUGH`` of values (..., N), evenly. An odd step meets all columns of most images."""
    return values[..., :: -(-values.shape[-1] // ENOUGH) | 1]


def thickness(height: np.ndarray) -> float:
    """Half thickness of a plane, from the scatter of the points on it; all relative."""
    height = np.abs(height)
    near = height[height < COARSE]
    sigma = 1.4826 * float(np.median(near)) if len(near) else 0.0
    return float(np.clip(3 * sigma, FINE, COARSE))


def framed(rays: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(2, M) where rays (2, M) are in the frame that those ``seen`` (2, N) span, -1 to 1."""
    if not seen.size:
        return rays
    low, high = np.quantile(some_of(seen), (0.001, 0.999), axis=1)[..., None]
    place = (rays - low.astype(np.float32)) * (2 / np.maximum(high - low, 1e-9)).astype(np.float32)
    place -= 1
    return np.clip(place, -1, 1, out=place)


@jit
def _cells(place):
    """(N,) int32 image cell of each place (2, N)."""
    cell = np.empty(place.shape[1], dtype=np.int32)
    for i in range(len(cell)):
        row, column = int((place[0, i] + 1) * (CELLS / 2)), int((place[1, i] + 1) * (CELLS / 2))
        cell[i] = row * (CELLS + 1) + column
    return cell


@jit
def _heights(points, plane, scale, cell):
    """(N,) float32, as ``Cloud.heights`` gives them."""
    side = CELLS + 1
    total, count = np.zeros(side * side), np.zeros(side * side)
    height = np.empty_like(scale)
    for i in range(len(height)):
        height[i] = plane[0] * points[0, i] + plane[1] * points[1, i] + plane[2] * points[2, i] - plane[3]
        height[i] /= scale[i]
    for i in range(len(height)):
        if abs(height[i]) < COARSE:
            total[cell[i]] += height[i]
            count[cell[i]] += 1
    for i in range(len(height)):
        if abs(height[i]) < COARSE:
            height[i] = total[cell[i]] / count[cell[i]]
    return height
