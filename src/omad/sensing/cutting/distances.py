"""Depth is along z. Of images that hold distances from the camera's centre, as laser scanners and some simulators give
them, planes are bent: table, floor or wall is then larger where the numbers are taken for distances."""

import numpy as np

from .cloud import Cloud
from .planes import find_plane

ON = 0.005
"""Of a plane, as a share of the distance: beside a narrow one distances would be, too."""
LARGER = 1.2
"""By how much a plane then is. Depth along z that is read as distances shows one that is smaller by a quarter or more
(nine frames of five focal lengths, three of them of real cameras)."""
LEAST = 0.15
"""Share of the points that it holds; smaller ones are found by chance."""
ENOUGH = 20_000
"""Points."""
TOLD = "the largest plane (table, floor or wall) is bent, and flat if depth is the distance from the camera's centre"
CURE = "give depth along z, which is that by the length of a pixel's ray (x, y, 1), or undo the lens"


def hold_distances(points: np.ndarray) -> bool:
    """Whether points (N, 3) in the camera frame were made of distances as if these were depth."""
    points = points[:: -(-len(points) // ENOUGH) or 1]
    if len(points) < LEAST * ENOUGH:
        return False
    flat, length = _share_on_plane(points), np.linalg.norm(points, axis=1, keepdims=True)
    share = _share_on_plane(points * (points[:, 2:] / np.maximum(length, 1e-9)))
    return share >= max(LEAST, LARGER * flat)


def _share_on_plane(points: np.ndarray) -> float:
    cloud, everything = Cloud.of(points), np.ones(len(points), dtype=bool)
    rng = np.random.default_rng(0)
    plane = find_plane(cloud, everything, rng, lambda normals: np.ones(len(normals), dtype=bool), behind_at_most=1.0)
    if plane is None:
        return 0.0
    height = (points @ plane[:3] - plane[3]) / cloud.scale
    return float((np.abs(height) < ON).mean())
