"""Tables that end within the frame, with their floor seen beside them: level planes of a thing that other things stand
on. An object's own faces are none: what rises from them reaches beyond them, or from one edge to the other."""

from dataclasses import replace
from functools import partial

import numpy as np

from .cloud import Cloud, every, some_of
from .clusters import all_clusters
from .footprints import PARALLEL, UP, axes_of, outline_of, width_of, within
from .planes import MIN_SHARE, Before, find_plane

MAX_BEHIND = 0.35
"""Of a table's points, with what stands on it: edges and legs, which are seen below its plane."""
MIN_OF_THING = 0.2
"""A table holds this share of them at least."""
INSIDE, BESIDE = 0.7, 0.05
"""Of what rises from a table, this share stands within its outline, or beside it by this share of its size: a thing may
hide the edge that it stands at, and a lid lean out over it."""
WIDE = 0.8
"""Nothing on a table is wider than this share of it: a lid is as wide as its laptop."""
LOWEST = 0.2
"""Metres over its floor, where that is found."""
MIN_FLOOR = 0.02
"""Share of all points on a floor that is looked for as there is a table."""
GROWN = 0.02
"""What is taken away with a table may lie so far beyond its outline, as a share of its size."""
LEAST = 20
"""Points of the smallest thing on a table, of those thinned."""


def take_tables_away(cloud: Cloud, before: Before) -> Before:
    """What is left of a cloud also without tables, their legs, and what is seen below them; and without the floor where
    so little is seen of it that only the table tells of it."""
    few = some_of(before.left)
    left, least = np.flatnonzero(few) * every(len(before.left)), int(MIN_SHARE * len(few))
    if len(left) < least:
        return before
    for thing in all_clusters(cloud.points.take(left, 1), least):
        table = _table_of(cloud.part(left[thing]), before)
        if table is None:
            continue
        plane, outline = table
        height, half = cloud.heights(plane)
        above = before.left & ~((height <= half) & within(outline, axes_of(plane), cloud.points))
        before = replace(_with(before, above, plane), lowest=max(before.lowest, half * cloud.middle))
        if (_over_parallel(plane, before.planes[:-1]) > 0).any():
            continue
        level, deep = partial(_parallel, plane), before.left & (height * cloud.scale < -LOWEST)
        floor = find_plane(cloud, deep, np.random.default_rng(0), level, share_at_least=MIN_FLOOR)
        if floor is not None:
            height, half = cloud.heights(floor)
            before = _with(before, before.left & (height > half), floor)
    return before


def _with(before: Before, left: np.ndarray, plane: np.ndarray) -> Before:
    """What is ``left`` (N,) with one more ``plane`` (4,) taken away."""
    return replace(before, left=left, planes=np.concatenate([before.planes, plane[None]]))


def _table_of(thing: Cloud, before: Before) -> tuple[np.ndarray, np.ndarray] | None:
    """The table (4,) that most points of a thing lie on or stand on, and its outline (16,); None where it is no table
    with things."""
    everything = np.ones(len(thing.scale), dtype=bool)
    plane = find_plane(thing, everything, np.random.default_rng(0), lambda normals: normals[:, 1] < -UP, MAX_BEHIND)
    if plane is None or (_over_parallel(plane, before.planes) < LOWEST).any():
        return None
    height, half = thing.heights(plane)
    on, above = np.flatnonzero(np.abs(height) < half), np.flatnonzero(height > half)
    if len(on) < MIN_OF_THING * len(height):
        return None
    axes = axes_of(plane)
    outline = outline_of(axes, thing.points, on)
    width = width_of(outline)
    things = all_clusters(thing.points.take(above, 1), LEAST)
    if not things or within(outline + BESIDE * width.max(), axes, thing.points)[above].mean() < INSIDE:
        return None
    if any((width_of(outline_of(axes, thing.points, above[one])) > WIDE * width).any() for one in things):
        return None
    return plane, outline + GROWN * width.max()


def _parallel(plane: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(H,) bool, which unit normals (H, 3) are those of a floor under a table (4,)."""
    return normals @ plane[:3] > PARALLEL


def _over_parallel(plane: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Metres that a table (4,) is over each of ``planes`` (P, 4) that may be its floor."""
    return plane[3] - planes[_parallel(plane, planes[:, :3]), 3]
