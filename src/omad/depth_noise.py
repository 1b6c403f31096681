"""What a stereo depth camera does to exact depth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from .camera import Camera


@dataclass(frozen=True)
class NoiseLevel:
    """Parameters of the noise; ``STANDARD`` is a small active-stereo camera."""

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
    grazing: float = np.radians(80)
    """Surfaces seen at more than this angle from their normal have no measurement."""
    holes: float = 0.005
    """Share of the pixels lost in blobs."""

    def scaled(self, factor: float) -> NoiseLevel:
        """Another level: all magnitudes times ``factor``; the grazing angle stays."""
        return replace(
            self,
            shift=self.shift * factor,
            disparity=self.disparity * factor,
            step=self.step * factor,
            edge_drop=min(self.edge_drop * factor, 1.0),
            holes=self.holes * factor,
        )


STANDARD = NoiseLevel()
HALF = STANDARD.scaled(0.5)
DOUBLE = STANDARD.scaled(2.0)


def add_noise(
    depth: np.ndarray, level: NoiseLevel, camera: Camera, rng: np.random.Generator, cos_view: np.ndarray | None = None
) -> np.ndarray:
    """Noisy copy of a depth image (H, W) in metres, 0 = no measurement.

    ``cos_view`` (H, W) is the cosine between surface normal and ray; estimated from the depth if not given.
    """
    rows, columns = np.nonzero(depth)
    result = np.zeros_like(depth)
    if not len(rows):
        return result
    margin = 4
    top, left = max(rows.min() - margin, 0), max(columns.min() - margin, 0)
    window = (slice(top, rows.max() + margin + 1), slice(left, columns.max() + margin + 1))
    exact = depth[window].astype(np.float64)
    shape = exact.shape

    cosine = _cosine(exact, camera, top, left) if cos_view is None else cos_view[window]
    valid = (exact > 0) & (cosine > np.cos(level.grazing))
    near_edge = _edges(exact)
    valid &= ~(near_edge & (rng.random(shape) < level.edge_drop))
    valid &= ~_blobs(shape, level.holes, rng)

    grid = np.indices(shape)
    shifted = np.rint(grid + level.shift * rng.standard_normal((2, *shape))).astype(int)
    source = (shifted[0].clip(0, shape[0] - 1), shifted[1].clip(0, shape[1] - 1))
    taken = np.where(exact[source] > 0, exact[source], exact)
    noise = ndimage.uniform_filter(level.disparity * rng.standard_normal(shape), 3)
    scale = camera.fx * level.baseline
    disparity = scale / np.where(valid, taken, 1.0) + noise
    if level.step > 0:
        disparity = np.rint(disparity / level.step) * level.step
    result[window] = np.where(valid & (disparity > 1e-6), scale / np.maximum(disparity, 1e-6), 0.0)
    return result


def _edges(depth: np.ndarray) -> np.ndarray:
    """Pixels beside a jump in depth or beside no depth at all."""
    high = ndimage.maximum_filter(np.where(depth > 0, depth, np.inf), 3)
    low = ndimage.minimum_filter(depth, 3)
    return (depth > 0) & ((low == 0) | (high - low > 0.05 * depth))


def _blobs(shape: tuple[int, int], share: float, rng: np.random.Generator) -> np.ndarray:
    """Random smooth blobs that cover about ``share`` of the pixels."""
    if share <= 0:
        return np.zeros(shape, dtype=bool)
    coarse = rng.standard_normal((shape[0] // 4 + 2, shape[1] // 4 + 2))
    field = ndimage.zoom(ndimage.gaussian_filter(coarse, 1.0), 4, order=1)[: shape[0], : shape[1]]
    return field > np.quantile(field, 1 - share)


def _cosine(depth: np.ndarray, camera: Camera, top: int, left: int) -> np.ndarray:
    """|cos| between ray and surface normal, from central differences of the back-projected depth."""
    v, u = np.indices(depth.shape)
    rays = np.stack([(u + left - camera.cx) / camera.fx, (v + top - camera.cy) / camera.fy, np.ones(depth.shape)], -1)
    points = rays * depth[..., None]
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(rays, axis=-1)
    return np.abs((normal * rays).sum(-1)) / np.maximum(length, 1e-12)
