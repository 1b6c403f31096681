"""Random images that are smooth: what correlated noise and blobs are made of."""

import numpy as np

REACH = 4
"""Lengths beyond which a node no longer counts."""


def smooth_field(shape: tuple[int, int], length: float, rng: np.random.Generator) -> np.ndarray:
    """(H, W) float32 Gaussian noise of mean 0 and variance 1 everywhere; pixels d apart are correlated by
    exp(-d^2 / (4 ``length``^2)), ``length`` in pixels; 0: white."""
    if length <= 0:
        return rng.standard_normal(shape, dtype=np.float32)
    down, across = (_weights(size, length) for size in shape)
    nodes = rng.standard_normal((down.shape[1], across.shape[1]), dtype=np.float32)
    return down @ nodes @ across.T


def _weights(size: int, length: float) -> np.ndarray:
    """(size, nodes) Gaussian weights of the nodes at each pixel of a line; their squares add up to 1."""
    nodes = np.arange(-REACH * length, size + REACH * length, max(length, 1.0), dtype=np.float32)
    away = np.abs(np.arange(size, dtype=np.float32)[:, None] - nodes) / length
    weights = np.where(away < REACH, np.exp(-0.5 * np.square(np.minimum(away, REACH))), np.float32(0))
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


def blobs(inside: np.ndarray, share: float, length: float, rng: np.random.Generator) -> np.ndarray:
    """(H, W) bool, random blobs some ``length`` pixels across that cover ``share`` of the pixels ``inside`` (H, W)."""
    field = smooth_field(inside.shape, length, rng)
    if share <= 0 or not inside.any():
        return np.zeros_like(inside)
    return field > np.quantile(field[inside], 1 - share)
