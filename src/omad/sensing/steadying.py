"""Depth averaged over neighbouring pixels of one surface: of distant things noise is most of what single pixels say."""

from dataclasses import replace

import numpy as np

from omad.common.compiled import jit

from .observation import Observation

REACH = 2
"""Pixels to every side."""
JUMP = 0.04
"""Neighbours whose depth differs by more than this share are of another surface."""


def steadied(seen: Observation) -> Observation:
    """The same with every point moved along its ray to the mean depth of its surface around it; a bare cloud as it
    is."""
    if seen.depth is None or seen.pixels is None:
        return seen
    z = np.ascontiguousarray(seen.points[:, 2])
    mean = _mean_depth(z, seen.pixels // seen.every, seen.depth.shape)
    return replace(seen, points=seen.points * (mean / z)[:, None])


@jit
def _mean_depth(depth, pixels, shape):
    """(N,) of the depth (N,) at ``pixels`` (N, 2), column and row in an image of ``shape``."""
    image = np.zeros((shape[0] + 2 * REACH, shape[1] + 2 * REACH), dtype=np.float32)
    for i in range(len(depth)):
        image[pixels[i, 1] + REACH, pixels[i, 0] + REACH] = depth[i]
    mean = np.empty_like(depth)
    for i in range(len(depth)):
        total, count = 0.0, 0
        for row in range(pixels[i, 1], pixels[i, 1] + 2 * REACH + 1):
            for column in range(pixels[i, 0], pixels[i, 0] + 2 * REACH + 1):
                if abs(image[row, column] - depth[i]) < JUMP * depth[i]:
                    total += image[row, column]
                    count += 1
        mean[i] = total / count if count else depth[i]  # of two points at one pixel, as a lens leaves them
    return mean
