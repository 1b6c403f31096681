"""Masks that are not quite the object's: (H, W) bool in, (H, W) bool out."""

import numpy as np
from scipy import ndimage

from ..rasteriser import NOTHING


def grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    """With all pixels at most ``pixels`` (between centres) from it; where negative, without those at most so far from
    its outside. The image's border is no outside."""
    if pixels == 0 or not mask.any():
        return mask.copy()
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    margin = abs(pixels) + 1
    window = tuple(slice(max(at[0] - margin, 0), at[-1] + margin + 1) for at in (rows, columns))
    result, cut = mask.copy(), mask[window]
    if pixels > 0:
        result[window] = np.asarray(ndimage.distance_transform_edt(~cut)) <= pixels
    elif not cut.all():
        result[window] = np.asarray(ndimage.distance_transform_edt(cut)) > -pixels
    return result


def without_part(mask: np.ndarray, labels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Without one of the parts, ``labels`` (H, W), that it shows; all of it where it shows but one."""
    parts = np.unique(labels[mask & (labels != NOTHING)])
    return mask & (labels != rng.choice(parts)) if len(parts) > 1 else mask


def shifted(mask: np.ndarray, pixels: int, rng: np.random.Generator) -> np.ndarray:
    """Moved by ``pixels`` in a random direction; what leaves the image is gone."""
    angle = rng.uniform(0, 2 * np.pi)
    move = np.rint(pixels * np.array([np.sin(angle), np.cos(angle)])).astype(int)
    return ndimage.shift(mask, move, order=0)


def with_rim(mask: np.ndarray, occluder: np.ndarray, pixels: int) -> np.ndarray:
    """With the pixels of ``occluder`` (H, W) that are at most ``pixels`` from the mask."""
    return mask | (grown(mask, pixels) & occluder)
