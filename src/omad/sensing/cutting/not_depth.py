"""Depth is along z. Of images that hold something else, planes are bent: table, floor or wall is then larger where the
numbers are taken for what they are. Distances from the camera's centre, as laser scanners and some simulators give
them, are told so, and disparities and inverse depth, as stereo matching and networks for single images do. Z-buffers
leave planes flat, though at other angles: what tells them is that 1 is where nothing was drawn.
"""

from dataclasses import dataclass

import numpy as np

from .cloud import Cloud
from .planes import find_plane

ON = 0.005
"""Of a plane, as a share of the distance: beside a narrow one distances would be, too."""
LARGER = 1.2
"""By how much a plane then is. Depth along z that is read as distances shows one that is smaller by a quarter or more
(nine frames of five focal lengths, three of them of real cameras)."""
LEAST, LEAST_INVERTED = 0.15, 0.3
"""Share of the points that it holds; smaller ones are found by chance. One over the depth of noisy cameras far away,
whose own planes are too rough to be found, has some that hold 0.2."""
ENOUGH = 20_000
"""Points."""
NOTHING_DRAWN = 0.01
"""Share of a z-buffer's pixels where it still holds what it was cleared with."""


@dataclass(frozen=True)
class NotDepth:
    """What images hold in place of depth."""

    told: str
    """How that shows."""
    why: str
    cure: str

    def __str__(self) -> str:
        return f"{self.told}; {self.cure}"


BENT = "the largest plane (table, floor or wall) is bent, and flat if"
DISTANCES = NotDepth(
    f"{BENT} depth is the distance from the camera's centre",
    "the image may hold distances, or be that of a wide lens",
    "give depth along z, which is that by the length of a pixel's ray (x, y, 1), or undo the lens",
)
INVERSE = NotDepth(
    f"{BENT} the numbers are one over the depth",
    "the image may hold disparities or inverse depth",
    "give depth in metres along z: focal length in pixels times baseline in metres, by the disparity",
)
Z_BUFFER = NotDepth(
    "no number is larger than 1, and many are just that",
    "the image may be a z-buffer, or depth as a share of the farthest",
    "give metres: of OpenGL's z-buffer near * far / (far - z * (far - near)), and 0 where z is 1",
)


def may_be_z_buffer(depth: np.ndarray) -> bool:
    """Whether an image (H, W) holds numbers up to 1, as renderers write them where nothing was drawn."""
    return bool(depth.max() == 1.0 and np.count_nonzero(depth == 1.0) >= NOTHING_DRAWN * depth.size)


def what_else(points: np.ndarray) -> NotDepth | None:
    """What points (N, 3) in the camera frame were made of as if it were depth; None where that may be depth."""
    points = points[:: -(-len(points) // ENOUGH) or 1]
    if len(points) < LEAST * ENOUGH:
        return None
    length, z = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9), np.maximum(points[:, 2:], 1e-9)
    larger = LARGER * _share_on_plane(points)
    if _share_on_plane(points * (z / length)) >= max(LEAST, larger):
        return DISTANCES
    return INVERSE if _share_on_plane(points / z**2) >= max(LEAST_INVERTED, larger) else None


def _share_on_plane(points: np.ndarray) -> float:
    cloud, everything = Cloud.of(points), np.ones(len(points), dtype=bool)
    rng = np.random.default_rng(0)
    plane = find_plane(cloud, everything, rng, lambda normals: np.ones(len(normals), dtype=bool), behind_at_most=1.0)
    if plane is None:
        return 0.0
    height = (points @ plane[:3] - plane[3]) / cloud.scale
    return float((np.abs(height) < ON).mean())
