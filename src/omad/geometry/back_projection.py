"""The points of a whole depth image, in one pass: NumPy would go over its million pixels a dozen times."""

import numpy as np

from omad.common.arrays import for_loops
from omad.common.compiled import jit

from .camera import Camera


def back_projected(camera: Camera, depth: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where in a depth image (H, W) float32 the ``used`` (H, W) bool pixels are, (N,) integers row by row, and the
    points (N, 3) that they show, in the camera frame; without those that a lens shows nowhere."""
    if camera.distortion is None:
        across = (np.arange(camera.width) - camera.cx) / camera.fx
        down = (np.arange(camera.height) - camera.cy) / camera.fy
        count = np.count_nonzero(used)  # NumPy's memory comes in large pages, which takes less time than Numba's
        place, columns = np.empty(count, dtype=np.int32), np.empty((3, count), dtype=np.float32)
        count = _fill(place, columns, for_loops(depth), for_loops(used), across, down)
        return place[:count], columns[:, :count].T
    place = np.flatnonzero(used)
    points = camera.backproject(pixels_at(place, camera.width), depth.ravel()[place])
    seen = np.isfinite(points).all(1)
    return place[seen], points[seen]


def pixels_at(place: np.ndarray, width: int) -> np.ndarray:
    """(N, 2) int column and row, of where pixels (N,) are in an image so wide."""
    pixels = np.empty((len(place), 2), dtype=int)
    np.divmod(place, width, out=(pixels[:, 1], pixels[:, 0]))
    return pixels


@jit
def _fill(place, columns, depth, used, across, down):
    """Write the places (N,) of ``used`` pixels and their points (3, N), of rays ``across`` (W,) and ``down`` (H,); how
    many there are."""
    height, width = depth.shape
    count = 0
    for row in range(height):
        for column in range(width):
            z = depth[row, column]
            x, y = across[column] * z, down[row] * z
            if count < len(place):  # unused ones are written, too, then over: branches would wait where holes scatter
                place[count] = row * width + column
                columns[0, count], columns[1, count], columns[2, count] = x, y, z
            count += used[row, column] & (abs(x) < np.inf) & (abs(y) < np.inf)
    return count
