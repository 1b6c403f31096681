"""3D IoU of part boxes that one pose and another carry to the camera."""

import numpy as np

from omad.geometry.rigid import carry

POINTS = 8192
"""That stand for a box's volume: the IoU is right to about 0.005."""
_STEP = 1.2207440846057596 ** -np.arange(1.0, 4.0)
"""Evenly spread points in three dimensions: multiples of these, less their whole part (Roberts' R3 sequence)."""


def box_iou(found: np.ndarray, true: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """IoU (K,) of the rest boxes (K, 2, 3) under a ``found`` pose and the true one (K, 4, 4); 0 where not finite. Both
    are the same box, so the IoU measures the pose alone: with a share s of each inside the other, s / (2 - s)."""
    inside = (np.arange(1.0, POINTS + 1)[:, None] * _STEP) % 1.0
    result = np.zeros(len(boxes))
    for k, (low, high) in enumerate(boxes):
        if not np.isfinite(found[k]).all():
            continue
        points, slack = low + inside * (high - low), 1e-9 * (high - low).max()
        both = (np.linalg.inv(b) @ a for a, b in ((found[k], true[k]), (true[k], found[k])))
        moved = np.stack([carry(T, points) for T in both])
        share = ((moved >= low - slack) & (moved <= high + slack)).all(-1).mean()
        result[k] = share / (2 - share)
    return result
