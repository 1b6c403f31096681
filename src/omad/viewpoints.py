"""Where standard views look from: random joint states and camera poses (seeded, any device)."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .camera import STANDARD_CAMERA
from .categories import ViewRange
from .geometry import axis_angle_to_matrix, make_transform

SPAN = (0.35, 0.9)
"""Share of the image height that the object's bounding sphere covers."""
OFF_CENTRE = 0.15
"""Largest shift of the object's centre off the image centre, as a share of the frame."""


def uniform(low: Tensor | float, high: Tensor | float, shape: tuple[int, ...], like: Tensor, generator) -> Tensor:
    """Uniform numbers of ``like``'s dtype and device."""
    return low + (high - low) * torch.rand(shape, dtype=like.dtype, device=like.device, generator=generator)


def sample_states(limits: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Joint states uniform between limits (B, J, 2), independently -> (B, J)."""
    return uniform(limits[..., 0], limits[..., 1], tuple(limits.shape[:-1]), limits, generator)


def look_at(azimuth: Tensor, elevation: Tensor, roll: Tensor) -> Tensor:
    """R_camera_base (B, 3, 3) of a camera at ``azimuth`` from the front, towards +x, looking at the origin."""
    toward = torch.stack(
        [azimuth.sin() * elevation.cos(), elevation.sin(), azimuth.cos() * elevation.cos()], -1
    )  # from object to camera
    forward = -toward
    up = torch.zeros_like(forward)
    up[..., 1] = 1
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, up, dim=-1), dim=-1)
    down = torch.linalg.cross(forward, right, dim=-1)
    z = torch.zeros_like(forward)
    z[..., 2] = 1
    return axis_angle_to_matrix(z, roll) @ torch.stack([right, down, forward], -2)


def sample_poses(views: ViewRange, centre: Tensor, radius: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Random T_camera_base (B, 4, 4) of standard views.

    ``centre`` (B, 3) and ``radius`` (B,) are the posed object's bounding sphere in the base frame, metres.
    """
    shape = tuple(radius.shape)
    azimuth = uniform(-views.azimuth, views.azimuth, shape, radius, generator)
    elevation = uniform(*views.elevation, shape, radius, generator)
    elevation = elevation.clamp(max=math.pi / 2 - 1e-3)  # straight down leaves the image's up direction undefined
    roll = uniform(-views.roll, views.roll, shape, radius, generator)
    rotation = look_at(azimuth, elevation, roll)

    camera = STANDARD_CAMERA
    span = uniform(*SPAN, shape, radius, generator) * camera.height
    distance = radius * (1 + (2 * camera.fy / span) ** 2).sqrt()
    shift_x = uniform(-OFF_CENTRE, OFF_CENTRE, shape, radius, generator) * camera.width / camera.fx
    shift_y = uniform(-OFF_CENTRE, OFF_CENTRE, shape, radius, generator) * camera.height / camera.fy
    centre_camera = torch.stack([shift_x * distance, shift_y * distance, distance], -1)
    translation = centre_camera - (rotation @ centre[..., None]).squeeze(-1)
    return make_transform(rotation, translation)
