"""What the network is shown: which points of a cloud, and in which frame."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from omad.geometry.transforms import make_transform
from omad.objects.category import Category
from omad.sensing.observation import Observation


def to_input_frame(points: Tensor, T_camera_input: Tensor) -> Tensor:
    """Camera-frame points (B, N, 3) in the input frame (B, 4, 4)."""
    return (points - T_camera_input[:, None, :3, 3]) @ T_camera_input[:, :3, :3]


def first_frame(points: Tensor) -> Tensor:
    """T_camera_input (B, 4, 4) of a first look: camera axes, moved to the cloud's mean."""
    eye = torch.eye(3, dtype=points.dtype, device=points.device).expand(len(points), 3, 3)
    return make_transform(eye, points.mean(1))


CELLS_SEEN = 40
"""Cells across an observed cloud: of the same size, as a cloud fills about 0.85 of its object's sphere."""


def choose_points(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Indices (count,) of points of an observed cloud (N, 3), spread over the image as those of training views are. A
    random point of each image cell, then a random choice of cells; where there are too few cells, they repeat."""
    some = rng.permutation(len(points))[:8192]
    rays = points[some, :2] / points[some, 2:]
    low, high = rays.min(0), rays.max(0)
    cell = np.floor((rays - low) / ((high - low).max() / CELLS_SEEN + 1e-9)).astype(np.int64)
    _, first = np.unique(cell[:, 0] * 100_000 + cell[:, 1], return_index=True)
    return np.resize(some[rng.permutation(first)], count)


def sample_clouds(
    views: Sequence[Observation], points: int, samples: int, seed: int, category: Category, device: torch.device | str
) -> tuple[Tensor, list[np.ndarray]]:
    """``samples`` random choices of ``points`` of each cloud, (B, samples, points, 3) in category units, and which
    points they are. Every cloud draws anew from ``seed``, so that a batch gives what single calls give."""
    chosen = []
    for view in views:
        rng = np.random.default_rng(seed)
        chosen.append(np.concatenate([choose_points(view.points, points, rng) for _ in range(samples)]))
    picked = np.stack([view.points[index] for view, index in zip(views, chosen, strict=True)])
    clouds = torch.as_tensor(picked / category.metres_per_unit, dtype=torch.float32, device=device)
    return clouds.unflatten(1, (samples, -1)), chosen
