"""Depth that is wrong or missing on an object: depth (H, W) metres and mask (H, W) bool in, depth out."""

import numpy as np

from ..smooth_fields import blobs, smooth_field

PATCH = (0.03, 0.2)
"""Metres by which a patch is nearer or farther."""
CLOSEST = 0.3
"""A patch is no nearer than this share of the depth."""
LENGTH = 15.0
"""Pixels: smoothness of waves ..."""
BLOB = 5.0
"""... and of blobs."""


def patched(depth: np.ndarray, mask: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """With one patch, ``share`` of the measured pixels in the mask, that is 3 to 20 cm nearer or farther."""
    rows, columns = np.nonzero(mask & (depth > 0))
    result = depth.copy()
    if share <= 0 or not len(rows):
        return result
    middle, stretch, angle = rng.integers(len(rows)), np.exp(rng.uniform(-0.7, 0.7)), rng.uniform(0, np.pi)
    down, across = rows - rows[middle], columns - columns[middle]
    along, aside = np.cos(angle) * across + np.sin(angle) * down, np.cos(angle) * down - np.sin(angle) * across
    inside = np.argsort(np.hypot(along * stretch, aside / stretch), kind="stable")[: round(share * len(rows))]
    wrong = rows[inside], columns[inside]
    offset = rng.uniform(*PATCH) * rng.choice([-1, 1])
    result[wrong] = np.maximum(depth[wrong] + offset, CLOSEST * depth[wrong])
    return result


def blotted(depth: np.ndarray, mask: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """With blobs without measurement that cover ``share`` of the measured pixels in the mask."""
    return np.where(blobs(mask & (depth > 0), share, BLOB, rng), np.float32(0), depth)


def wavy(depth: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """With a smooth error of ``sigma`` metres; pixels 8 apart are correlated by 0.93, 20 apart by 0.64."""
    wave = depth + np.float32(sigma) * smooth_field(depth.shape, LENGTH, rng)
    return np.where(depth > 0, np.maximum(wave, CLOSEST * depth), np.float32(0))
