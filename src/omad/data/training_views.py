"""Endless training views, made on the training device from part-labelled surface samples.

Nothing is rendered and no data set is stored: the samples of an object are posed, seen from a random
standard viewpoint, and the nearest sample of every cell of a coarse image is kept (a point z-buffer). Meshes
(``MeshBank``) are rendered instead, a point a cell: slower, but nothing shines through them.
One point a cell is also what random pixels of a depth image are: equally dense in the image.
``clutter`` spoils them, where it is asked for.
All lengths are in category units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from omad.geometry.camera import STANDARD_CAMERA
from omad.geometry.kinematics import part_transforms
from omad.geometry.transforms import transform_points
from omad.objects.category import Category

from .clutter.correlated_noise import add_correlated_noise
from .clutter.outline import Grid
from .clutter.settings import Clutter
from .clutter.spoil import SampledScene, spoil
from .mesh_bank import MeshBank
from .point_views import PosedSamples, look, pose, visible
from .rendering.depth_noise import ON
from .rendering.viewpoints import keep_possible, sample_poses, sample_states, uniform
from .surface_bank import SurfaceBank


@dataclass(frozen=True)
class ViewSettings:
    """How training views are drawn."""

    points: int = 512
    """Points of a view."""
    scale: tuple[float, float] = (0.9, 1.1)
    """Range of the random stretch of each canonical axis."""
    noise: float = 2.0
    """Largest depth-noise level, in multiples of the standard camera noise; half of the views have none."""
    clutter: Clutter | None = None
    """How views are spoilt as the world spoils them; None: not at all."""


@dataclass(frozen=True)
class ViewBatch:
    """B training views with their truth, in category units and radians."""

    points: Tensor
    """(B, n, 3) camera frame, random order."""
    labels: Tensor
    """(B, n) int64 part; their number where a point is not on the object."""
    states: Tensor
    """(B, J)."""
    T_camera_base: Tensor
    """(B, 4, 4)."""
    axes: Tensor
    """(B, J, 3) canonical space."""
    pivots: Tensor
    """(B, J, 3) canonical space."""
    indices: Tensor
    """(B,) which object of the bank."""
    scale: Tensor
    """(B, 3) its stretch."""


def draw_views(
    bank: SurfaceBank, category: Category, batch: int, settings: ViewSettings, generator: torch.Generator
) -> ViewBatch:
    """``batch`` random views of random objects of the bank; everything comes from ``generator``."""
    indices = torch.randint(len(bank), (batch,), device=bank.points.device, generator=generator)
    scale = uniform(*settings.scale, (batch, 3), bank.points, generator)
    if settings.clutter is not None:
        resized = torch.rand(batch, 1, device=scale.device, generator=generator) < settings.clutter.resized
        size = uniform(*settings.clutter.size, (batch, 1), bank.points, generator)
        scale = torch.where(resized, size * scale, scale)
    return draw_views_of(bank, category, indices, scale, settings, generator)


def draw_views_of(
    bank: SurfaceBank,
    category: Category,
    indices: Tensor,
    scale: Tensor,
    settings: ViewSettings,
    generator: torch.Generator,
) -> ViewBatch:
    """One random view of each of the objects ``indices`` (B,), stretched by ``scale`` (B, 3)."""
    like, batch, clutter = bank.points, len(indices), settings.clutter
    joints = bank.joints(indices, scale)
    states = sample_states(joints.limits, generator)
    if clutter is not None:
        states = _at_limits(states, joints.limits, clutter.shut, generator)
    keep_possible(states, joints.limits, category.joints)

    identity = torch.eye(4, dtype=like.dtype, device=like.device).expand(batch, 4, 4)
    T_base_part = part_transforms(category.tree, joints.axes, joints.pivots, states, identity)
    posed = pose(bank, indices, scale, T_base_part)
    T_camera_base, spoilt = _cameras(category, posed, clutter, generator)
    level = uniform(0.0, settings.noise, (batch,), like, generator)
    level = level * (torch.rand(batch, device=like.device, generator=generator) < 0.5)
    steepest = torch.where(level > 0, float(np.cos(ON.grazing)), -1.0)
    points, facing = look(posed, bank.closed[indices], T_camera_base, steepest)
    centre = transform_points(T_camera_base, posed.centre[:, None]).squeeze(1)
    if isinstance(bank, MeshBank):
        points, seen, labels = bank.seen(indices, points, centre, posed.radius, steepest, generator)
    else:
        seen, labels = visible(points, centre, posed.radius) & facing, bank.labels[indices]
    seen &= _in_frame(points)
    seen &= ~_holes(points, centre, posed.radius, level, generator)
    if clutter is not None:
        scene = SampledScene(points, seen, labels, centre, posed.radius, T_camera_base)
        points, seen, labels = spoil(scene, spoilt, clutter, len(category.parts), generator)

    # a random choice of the visible points; where there are too few, they repeat
    rank = torch.rand(seen.shape, device=like.device, generator=generator).masked_fill_(~seen, -1.0)
    slot = torch.arange(settings.points, device=like.device)[None] % seen.sum(1, keepdim=True).clamp(min=1)
    chosen = rank.topk(settings.points, dim=1).indices.gather(1, slot)
    picked = points.gather(1, chosen[..., None].expand(-1, -1, 3))
    picked = _add_noise(picked, level, category.metres_per_unit, generator)
    if clutter is not None:
        picked = add_correlated_noise(picked, Grid.over(centre, posed.radius), spoilt, clutter, generator)
    labels = labels.gather(1, chosen)
    return ViewBatch(picked, labels, states, T_camera_base, joints.axes, joints.pivots, indices, scale)


def _at_limits(states: Tensor, limits: Tensor, share: float, generator: torch.Generator) -> Tensor:
    """``states`` (B, J), of a ``share`` of the views instead all at one end of ``limits`` (B, J, 2)."""
    drawn = torch.rand(2, len(states), 1, device=states.device, generator=generator)
    low, high = limits.unbind(-1)
    near = torch.where(high.abs() < low.abs(), high, low)
    at_limit = torch.where(drawn[1] < 2 / 3, near, low + high - near)
    return torch.where(drawn[0] < share, at_limit, states)


def _cameras(
    category: Category, posed: PosedSamples, clutter: Clutter | None, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """T_camera_base (B, 4, 4), and which views are to be spoilt, (B,)."""
    sphere = posed.centre, posed.radius
    T_camera_base = sample_poses(category.views, *sphere, generator)
    if clutter is None:
        return T_camera_base, torch.zeros_like(posed.radius, dtype=torch.bool)
    share = torch.rand(2, len(posed.radius), device=posed.radius.device, generator=generator)
    spoilt, around = share[0] >= clutter.clean, share[1] < clutter.around
    other = sample_poses(clutter.views, *sphere, generator, span=clutter.span)
    return torch.where((spoilt & around)[:, None, None], other, T_camera_base), spoilt


def _in_frame(points: Tensor) -> Tensor:
    camera = STANDARD_CAMERA
    u = camera.fx * points[..., 0] / points[..., 2] + camera.cx
    v = camera.fy * points[..., 1] / points[..., 2] + camera.cy
    return (u > -0.5) & (u < camera.width - 0.5) & (v > -0.5) & (v < camera.height - 0.5)


def _holes(points: Tensor, centre: Tensor, radius: Tensor, level: Tensor, generator: torch.Generator) -> Tensor:
    """Blobs without measurement: in noisy views, a few discs of the image are empty."""
    gone = torch.zeros(points.shape[:2], dtype=torch.bool, device=points.device)
    for _ in range(2):
        shift = uniform(-1.0, 1.0, (len(points), 2), points, generator) * (radius / centre[:, 2])[:, None]
        size = uniform(0.0, 0.12, (len(points),), points, generator) * radius / centre[:, 2] * (level > 0)
        offset = points[..., :2] / points[..., 2:] - (centre[:, :2] / centre[:, 2:] + shift)[:, None]
        gone |= offset.square().sum(-1) < size[:, None].square()
    return gone


def _add_noise(points: Tensor, level: Tensor, metres_per_unit: float, generator: torch.Generator) -> Tensor:
    """Stereo-camera noise of ``level`` (B,) times ``ON``."""
    focal, baseline = STANDARD_CAMERA.fx, ON.baseline / metres_per_unit
    depth, level = points[..., 2:], level[:, None, None]

    def normal(like: Tensor) -> Tensor:
        return torch.randn(like.shape, dtype=like.dtype, device=like.device, generator=generator)

    rays = points[..., :2] / depth + ON.shift * level * normal(points[..., :2]) / focal
    disparity = focal * baseline / depth + ON.disparity / 3 * level * normal(depth)  # 3x3 smoothing leaves a third
    step = ON.step * level
    disparity = torch.where(step > 0, (disparity / step.clamp(min=1e-9)).round() * step, disparity)
    depth = focal * baseline / disparity.clamp(min=1e-3)
    return torch.cat([rays * depth, depth], -1)
