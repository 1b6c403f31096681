"""What the network is shown: which points of a cloud, and in which frame."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from omad.geometry.transforms import make_transform
from omad.objects.category import Category
from omad.sensing.observation import Observation
from omad.sensing.point_choice import choose_points


def to_input_frame(points: Tensor, T_camera_input: Tensor) -> Tensor:
    """Camera-frame points (B, N, 3) in the input frame (B, 4, 4)."""
    return (points - T_camera_input[:, None, :3, 3]) @ T_camera_input[:, :3, :3]


FAR = 2.0
"""Category units; objects are some 2 across."""


def first_frame(points: Tensor) -> Tensor:
    """T_camera_input (B, 4, 4) of a first look: camera axes, moved to the cloud's mean, without points too far from its
    median to be on the object, unless all are. Points (B, N, 3) in category units."""
    eye = torch.eye(3, dtype=points.dtype, device=points.device).expand(len(points), 3, 3)
    far = (points - points.median(1, keepdim=True).values).square().sum(-1) > FAR**2
    if not far.any():
        return make_transform(eye, points.mean(1))
    near = (~far | far.all(1, keepdim=True))[..., None]
    return make_transform(eye, (points * near).sum(1) / near.sum(1))


def sample_clouds(
    views: Sequence[Observation], points: int, samples: int, seed: int, category: Category, device: torch.device | str
) -> tuple[Tensor, list[np.ndarray]]:
    """``samples`` random choices of ``points`` of each cloud, (B, samples, points, 3) in category units, and which
    points they are. Every cloud draws anew from ``seed``, so that a batch gives what single calls give."""
    chosen = [choose_points(view.points, points, samples, seed).ravel() for view in views]
    picked = np.stack([view.points[index] for view, index in zip(views, chosen, strict=True)])
    clouds = torch.as_tensor(picked / category.metres_per_unit, dtype=torch.float32, device=device)
    return clouds.unflatten(1, (samples, -1)), chosen
