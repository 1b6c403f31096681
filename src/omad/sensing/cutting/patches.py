"""What hangs in the air: points that fly alone, and small patches of a mask, of wrong depth or of what is before or
behind the object."""

import numpy as np
from scipy.spatial import KDTree

from omad.common.compiled import jit
from omad.geometry.disjoint_sets import join, numbered
from omad.geometry.rigid import diagonal

JUMP = 0.03
"""Between neighbouring pixels of one surface the depth differs by less than this share: three times what a plane shows
that is seen at 80 degrees with 600 pixels of focal length."""
SMALL = 0.08
"""A patch holds less than this share of the mask's points ..."""
APART = 0.15
"""... and is farther than this share of its size from all that is larger."""
ENOUGH = 3000
"""Points of what is larger, at most, for the distance from it."""
NEIGHBOURS = 8
"""Of a point, to tell whether it flies alone."""


def flying(points: np.ndarray) -> np.ndarray:
    """(N,) bool, points (N, 3) much lonelier than the rest: mean neighbour distance over 3 robust deviations high.
    Distances are taken relative to the range, because the spacing of a camera's points grows with it."""
    if len(points) <= NEIGHBOURS:
        return np.zeros(len(points), dtype=bool)
    distances = KDTree(points).query(points, NEIGHBOURS + 1)[0][:, 1:].mean(1) / np.linalg.norm(points, axis=1)
    median = np.median(distances)
    return distances > median + 3 * 1.4826 * np.median(np.abs(distances - median)) + median


def hanging(points: np.ndarray, pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(N,) bool of points (N, 3) at ``pixels`` (N, 2), column and row in an image of ``shape`` (H, W), that are of no
    surface of the object: connected in the image by small steps in depth to only few others, and far from the rest."""
    thing = _surfaces(points[:, 2], pixels, shape)
    count = np.bincount(thing)
    small = (count < SMALL * len(points))[thing]
    if not small.any() or small.all():
        return np.zeros(len(points), dtype=bool)
    rest = points[~small]
    size = diagonal(rest)
    loose = np.flatnonzero(small)
    away, _ = KDTree(rest[:: -(-len(rest) // ENOUGH)]).query(points[loose], distance_upper_bound=APART * size)
    near = np.zeros(len(count), dtype=bool)
    near[thing[loose[np.isfinite(away)]]] = True
    return small & ~near[thing]


@jit
def _surfaces(depth, pixels, shape):
    """(N,) number of the surface each pixel is of: neighbours, corners included, whose depth (N,) hardly differs."""
    place = np.full((shape[0] + 1, shape[1] + 2), -1)  # with a border, so that no neighbour is outside
    root = np.arange(len(depth))
    for i in range(len(depth)):
        place[pixels[i, 1] + 1, pixels[i, 0] + 1] = i
    for i in range(len(depth)):
        row, column = pixels[i, 1] + 1, pixels[i, 0] + 1
        for down, across in ((0, -1), (-1, -1), (-1, 0), (-1, 1)):
            j = place[row + down, column + across]
            if j >= 0 and abs(depth[i] - depth[j]) < JUMP * min(depth[i], depth[j]):
                join(root, i, j)
    return numbered(root)
