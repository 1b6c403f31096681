"""Table, floor and walls stand at right angles: where they do not, the intrinsics are not those of the image.

A focal length k times too long makes everything narrower by k and as deep as before, so that the normal (x, y, z) of a
plane becomes (k x, k y, z). Of two normals that were at right angles this tells k.
"""

import numpy as np

RIGHT = 8.0
"""Degrees by which an angle may differ from 90: noise, and floors that are not level."""
FACTORS = (0.4, 2.5)
"""By which focal lengths are wrong: those of another size of the image."""
SLANTED, LEANING = 0.4, 60.0
"""Share of a plane's normal that shows in the image where it is seen at a slant, and the degrees from the image's up
from which on that is no table or floor of a level camera."""


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


def turn_doubts(planes: np.ndarray) -> tuple[str, ...]:
    """Where of ``planes`` (P, 4) that are seen at a slant, the largest first, none lies as table and floor do before a
    camera that is about level."""
    across, up = np.abs(planes[:, 0]), -planes[:, 1]
    slanted = np.hypot(across, up) > SLANTED
    leaning = np.degrees(np.arctan2(across, up))[slanted]
    if not len(leaning) or leaning.min() < LEANING:
        return ()
    what = f"the largest plane seen at a slant (table, floor or wall) leans by {leaning[0]:.0f}° in the image"
    return (f"{what}: if the camera is turned, give gravity (--gravity), or turn the image upright",)
