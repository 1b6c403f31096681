"""An object's front as an image: what was seen of it, looked at along the object's own depth.

From wherever it was seen, drawers are bands, handles are spots, and gaps are dark lines: what tells a chest of four
drawers from one of five, and neither a few points of the cloud nor its distance from a surface show it.

NumPy alone: a deployed program takes this file with it.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

ROWS, COLUMNS = 80, 48
"""Upwards, and to the object's left."""
CHANNELS = 5
ABOVE, BESIDE = 0.06, 0.1
"""What the image shows beyond the body, on either side, as a share of its height and width."""
BEHIND = 0.15
"""Heights of the body from its front to the deepest points that are of it."""
OUT, RELIEF = 0.3, 0.02
"""Heights of the body: units of the distance from its front, and from what lies around a place."""
AROUND = 9
"""Cells."""
MOST = 3.0
"""Any value, at most."""


def front_image(points: np.ndarray, T_camera_base: np.ndarray, body: np.ndarray) -> np.ndarray:
    """(5, ROWS, COLUMNS) float32 of points (N, 3), camera frame, metres, on an object whose base is at
    ``T_camera_base`` (4, 4), with a ``body`` (2, 3), low and high corners of its box in canonical space, metres.

    Channels: whether anything was seen in a cell; how far in front of the body's front in the mean; and how far in
    front of what is around it the mean, the foremost and the hindmost. All but the first are 0 where nothing was seen.
    """
    seen = (points - T_camera_base[:3, 3]) @ T_camera_base[:3, :3]
    width, height, _ = np.maximum(body[1] - body[0], 1e-3)
    column = np.floor(((seen[:, 0] - body[0, 0]) / width + BESIDE) / (1 + 2 * BESIDE) * COLUMNS)
    row = np.floor(((seen[:, 1] - body[0, 1]) / height + ABOVE) / (1 + 2 * ABOVE) * ROWS)
    out = (seen[:, 2] - body[1, 2]) / height
    shown = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS) & (out > -BEHIND)
    cell, out = (row[shown] * COLUMNS + column[shown]).astype(int), out[shown]

    size = ROWS * COLUMNS
    count = np.bincount(cell, minlength=size)
    mean = np.bincount(cell, out, size) / np.maximum(count, 1)
    foremost, hindmost = np.full(size, -np.inf), np.full(size, np.inf)
    np.maximum.at(foremost, cell, out)
    np.minimum.at(hindmost, cell, out)
    filled = count.reshape(ROWS, COLUMNS) > 0
    mean, foremost, hindmost = (
        np.where(filled, values.reshape(ROWS, COLUMNS), 0.0) for values in (mean, foremost, hindmost)
    )
    level = _mean_around(mean) / np.maximum(_mean_around(filled), 1e-6)
    relief = [np.where(filled, values - level, 0.0) / RELIEF for values in (mean, foremost, hindmost)]
    return np.stack([filled, mean / OUT, *relief]).clip(-MOST, MOST).astype(np.float32)


def _mean_around(values: np.ndarray) -> np.ndarray:
    """Of the cells around each of (ROWS, COLUMNS), mirrored at the borders."""
    for axis in (0, 1):
        padding = [(AROUND // 2, AROUND // 2) if a == axis else (0, 0) for a in (0, 1)]
        values = sliding_window_view(np.pad(values, padding, mode="symmetric"), AROUND, axis).mean(-1)
    return values
