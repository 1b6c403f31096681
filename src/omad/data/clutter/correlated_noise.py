"""Depth noise that neighbouring pixels share, as active stereo and structured light have it."""

import torch
from torch import Tensor

from omad.data.rendering.viewpoints import uniform

from .outline import Grid
from .regions import smooth_field
from .settings import Clutter


def add_correlated_noise(
    points: Tensor, grid: Grid, noisy: Tensor, clutter: Clutter, generator: torch.Generator
) -> Tensor:
    """Points (B, n, 3), in the camera frame, moved along their rays; those of ``noisy`` (B,) views."""
    batch = len(points)
    noisy = noisy & (torch.rand(batch, device=points.device, generator=generator) < clutter.correlated)
    spacing = uniform(*clutter.correlation, (batch,), points, generator) * grid.pixel
    sigma = uniform(0.0, clutter.amplitude, (batch, 1), points, generator) * noisy[:, None]
    off = sigma * smooth_field(grid.places(points), spacing, generator)
    return points * (1 + off / points[..., 2])[..., None]
