"""Where standard views look from: random joint states and camera poses (seeded, any device)."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.rigid import rigid
from omad.geometry.transforms import axis_angle_to_matrix, make_transform
from omad.objects.category import JointSpec, ViewRange

SPAN = (0.35, 0.9)
"""Share of the image height that the object's bounding sphere covers."""
STEEPEST = math.pi / 2 - 1e-3
"""Largest elevation, above and below: straight up and down, "up" would be undefined."""
OFF_CENTRE = 0.15
"""Largest shift of the object's centre off the image centre, as a share of the frame."""


def uniform(
    low: Tensor | float, high: Tensor | float, shape: tuple[int, ...], like: Tensor, generator: torch.Generator | None
) -> Tensor:
    """Uniform numbers (*shape) from ``low`` to ``high``, of ``like``'s dtype and device."""
    return low + (high - low) * torch.rand(shape, dtype=like.dtype, device=like.device, generator=generator)


def sample_states(limits: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Joint states uniform between limits (B, J, 2), independently -> (B, J)."""
    return uniform(limits[..., 0], limits[..., 1], tuple(limits.shape[:-1]), limits, generator)


def keep_possible(states: Any, limits: Any, joints: Sequence[JointSpec]) -> None:
    """Of joints that do not go further than another one (``at_most``), bring states (..., J) between limits (..., J, 2)
    down in proportion, in place; both are tensors, or both arrays."""
    for index, joint in enumerate(joints):
        if joint.at_most is not None:
            low, high = limits[..., index, 0], limits[..., index, 1]
            top = states[..., joint.at_most].clip(low, high)
            states[..., index] = low + (states[..., index] - low) * (top - low) / (high - low).clip(1e-12)


def random_states(limits: np.ndarray, joints: Sequence[JointSpec], rng: np.random.Generator) -> np.ndarray:
    """Possible joint states (J,) between limits (J, 2)."""
    states = rng.uniform(*limits.T)
    keep_possible(states, limits, joints)
    return states


def look_at(azimuth: Tensor, elevation: Tensor, roll: Tensor) -> Tensor:
    """R_camera_base (B, 3, 3) of a camera at ``azimuth`` from the front, towards +x, looking at the origin."""
    forward = -torch.stack([azimuth.sin() * elevation.cos(), elevation.sin(), azimuth.cos() * elevation.cos()], -1)
    up, z = torch.eye(3, dtype=forward.dtype, device=forward.device)[1:, None].expand(2, *forward.shape)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, up, dim=-1), dim=-1)
    down = torch.linalg.cross(forward, right, dim=-1)
    return axis_angle_to_matrix(z, roll) @ torch.stack([right, down, forward], -2)


def pose_before(distance: float, azimuth: float, elevation: float, centre: np.ndarray) -> np.ndarray:
    """T_camera_base (4, 4) of a camera ``distance`` metres from ``centre`` (3,), looking at it; radians, no roll."""
    angles = (torch.tensor([angle], dtype=torch.float64) for angle in (azimuth, elevation, 0.0))
    rotation = look_at(*angles)[0].numpy()
    return rigid(rotation, [0.0, 0.0, distance] - rotation @ centre)


def sample_poses(
    views: ViewRange,
    centre: Tensor,
    radius: Tensor,
    generator: torch.Generator | None = None,
    camera: Camera = STANDARD_CAMERA,
    span: tuple[float, float] = SPAN,
) -> Tensor:
    """Random T_camera_base (B, 4, 4) of standard views. ``centre`` (B, 3) and ``radius`` (B,) are the posed object's
    bounding sphere in the base frame, metres; ``span`` is the share of the image height that it covers."""

    def drawn(low: float, high: float) -> Tensor:
        return uniform(low, high, tuple(radius.shape), radius, generator)

    azimuth = drawn(-views.azimuth, views.azimuth)
    elevation = drawn(*views.elevation).clamp(-STEEPEST, STEEPEST)
    rotation = look_at(azimuth, elevation, drawn(-views.roll, views.roll))
    distance = radius * (1 + (2 * camera.fy / (drawn(*span) * camera.height)) ** 2).sqrt()
    sizes = (camera.width, camera.fx), (camera.height, camera.fy)
    shift = [drawn(-OFF_CENTRE, OFF_CENTRE) * size / focal * distance for size, focal in sizes]
    return make_transform(rotation, torch.stack([*shift, distance], -1) - (rotation @ centre[..., None]).squeeze(-1))
