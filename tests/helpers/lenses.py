"""A frame as a camera with a lens sees it."""

import numpy as np
from scipy.ndimage import map_coordinates

from omad.geometry.lens import Distortion

BROWN = (0.12, -0.25, 0.0009, -0.0006, 0.08)
K = np.array([[600.0, 0, 319.5], [0, 600, 239.5], [0, 0, 1]])


def seen_through(lens: Distortion, depth: np.ndarray) -> np.ndarray:
    """What a camera with this lens sees in place of ``depth``: each of its pixels looks up its ray, bilinearly."""
    rows, columns = np.indices(depth.shape)
    rays = lens.undistort((np.stack([columns, rows], -1).reshape(-1, 2) - (319.5, 239.5)) / 600)
    place = (rays * 600 + (319.5, 239.5)).T[::-1]
    nearest = map_coordinates(depth, np.nan_to_num(place, nan=-1), order=0, mode="constant")
    smooth = map_coordinates(depth, np.nan_to_num(place, nan=-1), order=1, mode="constant")
    # at the border of the object bilinear depth would fly between it and nothing
    return np.where((nearest > 0) & (np.abs(smooth - nearest) < 0.02), smooth, nearest).reshape(depth.shape)
