"""The object that stands on a table or floor, cut out of a cluttered frame by geometry alone."""

from dataclasses import dataclass

import numpy as np

from .cloud import Cloud, Frame, some_of
from .clusters import all_clusters, prominent_cluster
from .pieces import joined
from .planes import take_planes_away
from .tables import take_tables_away

RIVAL = 0.5
"""Another cluster with this share of the chosen one's weight makes the choice doubtful."""
WITHIN = 0.5
"""A thing with this share of its points where one looks is what is looked for; its neighbours only reach inside."""
MARGIN, TOUCHED = 0.05, 0.02
"""A margin as wide as this share of the image; the share of it that is measured in frames that show more than what was
cut out."""
NEIGHBOUR = 50
"""Points of the smallest thing that may be a neighbour."""


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
    ``inside`` (N,) bool says where the object is looked for; the planes are found in the whole cloud, and what reaches
    inside of things that mostly lie elsewhere is left out. A cluster's weight is its squared size, more in the middle
    of the frame (or of what is inside) than at its border.
    Deterministic: the same cloud gives the same answer."""
    cloud = Cloud.of(points)
    before = take_tables_away(cloud, take_planes_away(cloud))
    left = before.left.copy()
    if inside is not None and not inside.all():
        left &= inside
        left[_neighbours(cloud, before.left, inside)] = False
    index = np.flatnonzero(left)
    place = cloud.places(index)
    if inside is not None:
        place = Frame.of(cloud.places(some_of(np.flatnonzero(inside)))).places(place)
    central = (1 - np.abs(place)).prod(0)
    chosen, rival = prominent_cluster(cloud.points.take(index, 1), central)
    left[index] = chosen
    return Segment(left, before.planes, rival)


def _neighbours(cloud: Cloud, left: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Indices of the points ``left`` (N,) of things that only reach ``inside`` (N,), with less than a thing that mostly
    lies there has."""
    index = np.flatnonzero(left)
    things = [index[thing] for thing in all_clusters(cloud.points.take(index, 1), NEIGHBOUR)]
    seen = [np.count_nonzero(inside[thing]) for thing in things]
    most = max((count for count, thing in zip(seen, things, strict=True) if count >= WITHIN * len(thing)), default=0)
    beside = [thing for count, thing in zip(seen, things, strict=True) if count < min(most, WITHIN * len(thing))]
    return np.concatenate([np.zeros(0, dtype=int), *beside])


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
    cloud = Cloud.of(points)
    before = take_tables_away(cloud, take_planes_away(cloud))
    index = np.flatnonzero(before.left)
    clusters = [index[thing] for thing in all_clusters(cloud.points.take(index, 1), least)]
    return Things(joined(cloud, clusters, before.planes), before.planes, before.lowest)


def things_alone(points: np.ndarray, least: int) -> list[np.ndarray]:
    """Indices of each thing of at least ``least`` points in a camera-frame cloud (N, 3) without surroundings."""
    return all_clusters(np.ascontiguousarray(points.T, dtype=np.float32), least)


def share_of_margin(measured: np.ndarray) -> float:
    """Of the margin of an image (H, W) bool the share that is ``measured``: an object that was cut out already hardly
    reaches it."""
    height, width = measured.shape
    down, across = max(int(MARGIN * height), 1), max(int(MARGIN * width), 1)
    inner = measured[down : height - down, across : width - across]
    seen = np.count_nonzero(measured) - np.count_nonzero(inner)
    return seen / (measured.size - inner.size)
