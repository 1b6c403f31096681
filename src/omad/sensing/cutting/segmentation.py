"""The object that stands on a table or floor, cut out of a cluttered frame by geometry alone."""

from dataclasses import dataclass

import numpy as np

from .clusters import all_clusters, prominent_cluster
from .planes import some_of, take_planes_away

RIVAL = 0.5
"""Another cluster with this share of the chosen one's weight makes the choice doubtful."""


@dataclass(frozen=True)
class Segment:
    """The most prominent thing in front of the supporting planes."""

    selected: np.ndarray
    """(N,) bool."""
    planes: np.ndarray
    """(P, 4) n and d of the planes n . p = d taken away, n towards the camera; empty where none was found."""
    rival: float
    """Weight of the second cluster as a share of the chosen one's."""


def segment_on_plane(points: np.ndarray, inside: np.ndarray | None = None) -> Segment:
    """Find table, floor and walls in a camera-frame cloud (N, 3) and select the most prominent cluster before them.
    ``inside`` (N,) bool says where the object is looked for; the planes are found in the whole cloud. A cluster's
    weight is its squared size, more in the middle of the frame (or of what is inside) than at its border.
    Deterministic: the same cloud gives the same answer."""
    columns, distance, place = _columns(points)
    before = take_planes_away(columns, distance, place)
    left = before.left
    if inside is not None and not inside.all():
        left &= inside
        place = np.zeros_like(place)
        place[:, inside] = _place(columns[:2, inside] / np.maximum(columns[2, inside], 1e-9))
    index = np.flatnonzero(left)
    central = (1 - np.abs(place.take(index, 1))).prod(0)
    chosen, rival = prominent_cluster(columns.take(index, 1), distance[index], central)
    left[index] = chosen
    return Segment(left, before.planes, rival)


@dataclass(frozen=True)
class Things:
    """What stands before the supporting planes."""

    clusters: list[np.ndarray]
    """Indices of each thing's points, the largest thing first."""
    planes: np.ndarray
    """(P, 4) as of a ``Segment``."""
    lowest: float
    """Metres: what rises less over a plane, at the middle distance, is not among them."""


def things_before_planes(points: np.ndarray, least: int) -> Things:
    """All things of at least ``least`` points before table, floor and walls in a camera-frame cloud (N, 3)."""
    columns, distance, place = _columns(points)
    before = take_planes_away(columns, distance, place)
    index = np.flatnonzero(before.left)
    clusters = [index[thing] for thing in all_clusters(columns.take(index, 1), distance[index], least)]
    return Things(clusters, before.planes, before.lowest)


def things_alone(points: np.ndarray, least: int) -> list[np.ndarray]:
    """Indices of each thing of at least ``least`` points in a camera-frame cloud (N, 3) without surroundings."""
    columns, distance, _ = _columns(points)
    return all_clusters(columns, distance, least)


def _columns(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A cloud (N, 3) as (3, N) float32, the distance of each point (N,), and its place in the frame (2, N)."""
    columns = np.ascontiguousarray(points.T, dtype=np.float32)
    distance = np.sqrt(np.einsum("an,an->n", columns, columns))
    return columns, distance, _place(columns[:2] / np.maximum(columns[2], 1e-9))


def _place(rays: np.ndarray) -> np.ndarray:
    """(2, N) place of rays (2, N) in the frame, -1 to 1; the frame is what they span."""
    if not rays.size:
        return rays
    low, high = np.quantile(some_of(rays), (0.001, 0.999), axis=1)[..., None]
    place = (rays - low.astype(np.float32)) * (2 / np.maximum(high - low, 1e-9)).astype(np.float32)
    place -= 1
    return np.clip(place, -1, 1, out=place)
