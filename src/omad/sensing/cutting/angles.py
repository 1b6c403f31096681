"""Table, floor and walls stand at right angles: where they do not, the intrinsics are not those of the image.

A focal length k times too long makes everything narrower by k and as deep as before, so that the normal (x, y, z) of a
plane becomes (k x, k y, z). Of two normals that were at right angles this tells k.
"""

import numpy as np

RIGHT = 8.0
"""Degrees by which an angle may differ from 90: noise, and floors that are not level."""
FACTORS = (0.4, 2.5)
"""By which focal lengths are wrong: those of another size of the image."""


def angle_doubts(planes: np.ndarray) -> tuple[str, ...]:
    """What to doubt of the intrinsics that planes (P, 4) n . p = d were seen with, the largest first; nothing where
    there is one plane, or the first two stand as they should, or no focal length explains how they stand."""
    if len(planes) < 2:
        return ()
    one, other = planes[:2, :3]
    angle = np.degrees(np.arccos(np.clip(one @ other, -1, 1)))
    across, along = one[:2] @ other[:2], one[2] * other[2]
    if abs(angle - 90) < RIGHT or across * along >= 0:
        return ()
    factor = float(np.sqrt(-along / across))  # of a focal length that makes it 90 degrees
    if not FACTORS[0] < factor < FACTORS[1]:
        return ()
    right = f"with a focal length {factor:.2g} times as long it would be 90°"
    what = f"the two largest planes (table, floor or wall) stand at {angle:.0f}°: {right}"
    return (f"{what}; are the intrinsics those of this image, at its size?",)
