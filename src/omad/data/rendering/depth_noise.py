"""What a stereo depth camera does to exact depth."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy import ndimage

from omad.geometry.camera import Camera


@dataclass(frozen=True)
class NoiseLevel:
    """Parameters of the noise; the defaults are those of a small active-stereo camera."""

    baseline: float = 0.05
    """Metres between the two imagers."""
    shift: float = 0.5
    """Standard deviation of the pixel shift, pixels."""
    disparity: float = 0.08
    """Standard deviation of the disparity noise before it is smoothed over 3x3 pixels, pixels."""
    step: float = 1 / 32
    """Disparity quantisation, pixels."""
    edge_drop: float = 0.5
    """Probability that a pixel at a depth edge has no measurement."""
    grazing: float = float(np.radians(80))
    """Surfaces seen at more than this angle (radians) from their normal have no measurement."""
    holes: float = 0.005
    """Share of the pixels lost in blobs."""

    def scaled(self, factor: float) -> Self:
        """Another level: all magnitudes times ``factor``; the camera's baseline and the grazing angle stay."""
        scaled = {name: getattr(self, name) * factor for name in ("shift", "disparity", "step", "holes")}
        return replace(self, edge_drop=min(self.edge_drop * factor, 1.0), **scaled)


ON = NoiseLevel()
HALF = ON.scaled(0.5)
DOUBLE = ON.scaled(2.0)
LEVELS: dict[str, NoiseLevel | None] = {"off": None, "half": HALF, "on": ON, "double": DOUBLE}
"""The levels of the robustness tables; None leaves the depth exact."""

EDGE = 0.03
"""A depth edge is a jump by more than this share of the depth between a pixel and one of its eight neighbours: just
above what a plane at the grazing angle shows (sqrt 2 tan 80 degrees / 600 pixels of focal length, twice over)."""


def add_noise(
    depth: np.ndarray,
    level: NoiseLevel | None,
    camera: Camera,
    rng: np.random.Generator,
    cos_view: np.ndarray | None = None,
) -> np.ndarray:
    """Noisy float32 copy of a depth image (H, W) in metres, 0 = no measurement; the same for the same ``rng`` state.
    ``cos_view`` (H, W) is the cosine between surface normal and ray; estimated from the depth if not given."""
    result = depth.astype(np.float32)
    rows, columns = np.nonzero(result.any(1))[0], np.nonzero(result.any(0))[0]
    if level is None or not len(rows):
        return result
    # the background beside the object makes its outline an edge
    top, left = max(rows[0] - 1, 0), max(columns[0] - 1, 0)
    window = slice(top, rows[-1] + 2), slice(left, columns[-1] + 2)
    exact = result[window].copy()
    shape = exact.shape
    cosine = _cosine(exact, camera, top, left) if cos_view is None else cos_view[window]
    valid = (exact > 0) & (cosine > np.cos(level.grazing))
    valid &= ~(_edges(exact) & (rng.random(shape, dtype=np.float32) < level.edge_drop))
    valid &= ~_blobs(shape, level.holes, rng)

    scale = camera.fx * level.baseline
    disparity = scale / np.where(exact > 0, _shifted(exact, level.shift, rng), 1.0)
    disparity += level.disparity * ndimage.uniform_filter(rng.standard_normal(shape, dtype=np.float32), 3)
    if level.step > 0:
        disparity = np.rint(disparity / level.step) * level.step
    valid &= disparity > 0
    result[window] = np.where(valid, scale / np.where(valid, disparity, 1.0), 0.0)
    return result


def _shifted(depth: np.ndarray, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Every pixel's depth taken from a pixel nearby; its own where that one has none."""
    height, width = depth.shape
    drift = np.rint(sigma * rng.standard_normal((2, height, width), dtype=np.float32)).astype(np.int32)
    rows = (np.arange(height, dtype=np.int32)[:, None] + drift[0]).clip(0, height - 1)
    columns = (np.arange(width, dtype=np.int32) + drift[1]).clip(0, width - 1)
    taken = depth.ravel()[rows * width + columns]
    return np.where(taken > 0, taken, depth)


def _edges(depth: np.ndarray) -> np.ndarray:
    """Pixels beside a jump in depth or beside no depth at all."""
    high, low = ndimage.maximum_filter(depth, 3), ndimage.minimum_filter(depth, 3)
    return (depth > 0) & (np.maximum(high - depth, depth - low) > EDGE * depth)


def _blobs(shape: tuple[int, ...], share: float, rng: np.random.Generator) -> np.ndarray:
    """Random smooth blobs, some ten pixels across, that cover ``share`` of the pixels."""
    if share <= 0:
        return np.zeros(shape, dtype=bool)
    coarse = rng.standard_normal((shape[0] // 2 + 1, shape[1] // 2 + 1), dtype=np.float32)
    field = ndimage.gaussian_filter(coarse, 2.0, mode="wrap")
    blobs = field > np.quantile(field, 1 - share)
    return blobs.repeat(2, 0).repeat(2, 1)[: shape[0], : shape[1]]


def _cosine(depth: np.ndarray, camera: Camera, top: int, left: int) -> np.ndarray:
    """|cos| between ray and surface normal, from differences of the back-projected depth (window at top, left). On each
    side the difference to the nearer neighbour in depth is taken, so that edges do not look grazing."""
    x = ((np.arange(depth.shape[1]) + left - camera.cx) / camera.fx).astype(np.float32)[None]
    y = ((np.arange(depth.shape[0]) + top - camera.cy) / camera.fy).astype(np.float32)[:, None]
    # p(u, v) = z (x, y, 1), so dp/du x dp/dv ~ (-a, -b, z + a x + b y), and its product with the ray is z
    a, b = camera.fx * _slope(depth, 1), camera.fy * _slope(depth, 0)
    squared = (a**2 + b**2 + (depth + x * a + y * b) ** 2) * (x * x + y * y + 1)
    return depth / np.sqrt(np.maximum(squared, np.float32(1e-12)))


def _slope(depth: np.ndarray, axis: int) -> np.ndarray:
    """Depth change per pixel: the smaller of forward and backward difference, 0 where both neighbours are missing."""
    line = np.moveaxis(depth, axis, 0)
    step = np.where(np.minimum(line[1:], line[:-1]) > 0, np.diff(line, axis=0), np.float32(np.inf))
    end = np.full_like(line[:1], np.inf)
    forward, backward = np.concatenate([step, end]), np.concatenate([end, step])
    slope = np.where(np.abs(forward) < np.abs(backward), forward, backward)
    return np.moveaxis(np.where(np.isfinite(slope), slope, np.float32(0)), 0, axis)
