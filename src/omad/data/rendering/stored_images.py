"""Depth and labels as PNG files hold them."""

from pathlib import Path

import numpy as np
from PIL import Image

from omad.common.files import write_atomic

from .rasteriser import NOTHING


def write_depth(path: Path, depth: np.ndarray, depth_scale: float) -> np.ndarray:
    """Write depth (H, W) metres as 16-bit PNG -> the stored integers."""
    stored = as_stored(depth, depth_scale)
    write_png(path, stored)
    return stored


def as_stored(depth: np.ndarray, depth_scale: float) -> np.ndarray:
    """(H, W) uint16 of depth (H, W) metres; what does not fit into 16 bits, of which the largest number says that there
    is no measurement, is 0."""
    stored = np.rint(depth / depth_scale)
    return np.where(stored < 2**16 - 1, stored, 0).astype(np.uint16)


def where_stored(image: np.ndarray, depth: np.ndarray, depth_scale: float) -> np.ndarray:
    """Labels (H, W) uint8 as NOTHING where depth (H, W) metres is not stored, as of a wall that is too far for it."""
    return np.where(as_stored(depth, depth_scale) > 0, image, np.uint8(NOTHING))


def write_png(path: Path, image: np.ndarray) -> None:
    """8 or 16 bit, whole or not at all."""
    write_atomic(path, lambda temporary: Image.fromarray(image).save(temporary, "PNG", compress_level=1))
