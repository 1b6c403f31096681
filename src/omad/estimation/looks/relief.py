"""What stands out of a closed door, or is sunk into it, and where: its handle is far from its hinge.

NumPy alone: a deployed program takes this file with it.
"""

from collections.abc import Sequence

import numpy as np

STRIPS = np.linspace(-0.5, 1.5, 11)
"""Edges of strips along the hinge: 0 is the hinge, 1 the far edge of the door; beyond lies what is beside it."""
MOST = 2000
"""Points that are looked at, or not twice as many."""
FEWEST = 30
"""Points of a face."""
INSIDE = 0.03, 0.97
"""Of the face: its rim is left out."""
NEAR, FAR = 0.1, 0.15
"""Category units from where the face should be, and from where it is, that are looked at."""
FLAT, LEAST = 0.002, 0.006
"""Category units: what is part of the face at least, and what stands out of it at least."""
ROUGH, OUT = 2.5, 3.0
"""The same in the face's own standard deviations."""
ROUNDS = 4
FLOOR = 0.003
"""Added to shares before their logarithm is taken."""
AJAR = np.radians(10)
"""A door that is open so far is no longer like one that is shut."""


def as_shut(known: np.ndarray, front: float, state: float, out: np.ndarray) -> np.ndarray:
    """(2 n + 33,) what is ``known`` (n,) of an object whose first joint is at ``state`` radians, once as of an open
    door and once as of a shut one, what stands ``out`` of it (30,) as of a shut one, how shut it is, and what its
    ``front`` says, once as of either."""
    shut = np.exp(-((state / AJAR) ** 2))
    either = [front * (1 - shut), front * shut]
    return np.concatenate([known * (1 - shut), known * shut, out * shut, [shut], either])


def relief(
    points: np.ndarray,
    keypoints: np.ndarray,
    part_of_keypoint: Sequence[int],
    T_camera_part: np.ndarray,
    axis: np.ndarray,
    pivot: np.ndarray,
    unit: float,
) -> np.ndarray:
    """(30,) of each of ten strips along the first joint's axis the logarithm of its share of points (N, 3) that stand
    out of the plane of the part that turns about it, lie in it, and are behind it; relative to those of its whole face.

    ``keypoints`` (M, 3) of the answer, ``axis`` and ``pivot`` (3,) of the joint, and points are in the camera frame,
    metres; ``unit`` is the category's.
    """
    part = np.array(part_of_keypoint)
    face = keypoints[part == 1]
    away = face.mean(0) - pivot
    away = away - axis * (away @ axis)
    away /= max(float(np.linalg.norm(away)), 1e-12)
    outwards = np.cross(axis, away)
    # the rest of the object lies behind the part when it is at rest
    body = np.append(keypoints[part == 0].mean(0), 1.0)
    rest = (T_camera_part[1] @ np.linalg.solve(T_camera_part[0], body))[:3]
    outwards *= np.sign((face.mean(0) - rest) @ outwards)
    some = points[:: max(1, len(points) // MOST)].astype(np.float64) - pivot
    along, width = (face - pivot) @ axis, max(float(((face - pivot) @ away).max()), 1e-12)
    across, height = some @ away / width, some @ outwards / unit
    up = (some @ axis - along.min()) / max(float(np.ptp(along)), 1e-12)
    shares = _shares(across, up, height)
    return np.log(np.concatenate(shares) + FLOOR)


def _shares(across: np.ndarray, up: np.ndarray, height: np.ndarray) -> np.ndarray:
    """(3, 10) of what stands out, lies in the face, and is behind it; zeros where no face is seen."""
    level = (up > INSIDE[0]) & (up < INSIDE[1])
    whole = level & (across > INSIDE[0]) & (across < INSIDE[1])
    near = whole & (np.abs(height) < NEAR)
    if near.sum() < FEWEST:
        return np.zeros((3, len(STRIPS) - 1))
    terms = np.column_stack([np.ones(len(up)), across, up])
    off = height - np.median(height[near])
    rough = _spread(off[near])
    for _ in range(ROUNDS):
        kept = near & (np.abs(off) <= max(ROUGH * rough, FLAT))
        plane, *_ = np.linalg.lstsq(terms[kept].T @ terms[kept], terms[kept].T @ height[kept], rcond=None)
        off = height - terms @ plane
        rough = _spread(off[kept])
    least = max(OUT * rough, LEAST)
    seen = level & (np.abs(off) < FAR)
    groups = off > least, np.abs(off) <= least, off < -least
    counts = [np.histogram(across[seen & group], STRIPS)[0] for group in groups]
    return np.array(counts) / max(int((seen & whole).sum()), 1)


def _spread(values: np.ndarray) -> float:
    """Standard deviation, as the median absolute deviation tells it."""
    return 1.4826 * float(np.median(np.abs(values)))
