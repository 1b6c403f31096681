"""Endless training views, made on the training device from part-labelled surface samples.

Nothing is rendered and no data set is stored: the samples of an object are posed, seen from a random
standard viewpoint, and the nearest sample of every cell of a coarse image is kept (a point z-buffer).
One point a cell is also what random pixels of a depth image are: equally dense in the image.
All lengths are in category units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor

from omad.geometry.camera import STANDARD_CAMERA
from omad.geometry.kinematics import part_transforms
from omad.geometry.transforms import bounding_box
from omad.objects.category import Category
from omad.objects.model import SampledObject

from .rendering.depth_noise import ON
from .rendering.viewpoints import sample_poses, sample_states, uniform

GRID = 48
"""Cells of the point z-buffer across the object's bounding sphere."""


@dataclass(frozen=True)
class SurfaceBank:
    """Surface samples of a set of N objects, S each, in category units."""

    points: Tensor
    """(N, S, 3) canonical space at rest."""
    normals: Tensor
    """(N, S, 3) unit, outward."""
    labels: Tensor
    """(N, S) int64 part."""
    axes: Tensor
    """(N, J, 3)."""
    pivots: Tensor
    """(N, J, 3)."""
    limits: Tensor
    """(N, J, 2) radians or category units."""
    closed: Tensor
    """(N,) bool: normals are trusted to point outward, so that points on the far side can be culled."""

    @classmethod
    def from_models(
        cls, models: Sequence[SampledObject], category: Category, samples: int = 8192, seed: int = 0
    ) -> SurfaceBank:
        """Sample every model; the same seed gives the same bank."""
        drawn = [m.surface_samples(samples, np.random.default_rng([seed, i])) for i, m in enumerate(models)]
        unit = category.metres_per_unit

        def tensor(arrays: Sequence[np.ndarray]) -> Tensor:
            return torch.as_tensor(np.stack(arrays), dtype=torch.float32)

        return cls(
            points=tensor([d.points / unit for d in drawn]),
            normals=tensor([d.normals for d in drawn]),
            labels=torch.as_tensor(np.stack([d.labels for d in drawn])),
            axes=tensor([m.axes for m in models]),
            pivots=tensor([m.pivots / unit for m in models]),
            limits=tensor([m.limits / category.state_units[:, None] for m in models]),
            closed=torch.tensor([m.closed for m in models]),
        )

    def __len__(self) -> int:
        return len(self.points)

    def to(self, device: torch.device | str) -> SurfaceBank:
        return SurfaceBank(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})

    def scaled(self, indices: Tensor, scale: Tensor) -> SurfaceBank:
        """Objects ``indices`` (B,) stretched by ``scale`` (B, 3) along the canonical axes, joints along with them."""
        chosen = SurfaceBank(**{f.name: getattr(self, f.name)[indices] for f in fields(self)})
        axes, scale = chosen.axes * scale[:, None], scale[:, None]
        return replace(
            chosen,
            points=chosen.points * scale,
            normals=torch.nn.functional.normalize(chosen.normals / scale, dim=-1),
            axes=axes / axes.norm(dim=-1, keepdim=True),
            pivots=chosen.pivots * scale,
        )


@dataclass(frozen=True)
class ViewSettings:
    """How training views are drawn."""

    points: int = 512
    """Points of a view."""
    scale: tuple[float, float] = (0.9, 1.1)
    """Range of the random stretch of each canonical axis."""
    noise: float = 2.0
    """Largest depth-noise level, in multiples of the standard camera noise; half of the views have none."""


@dataclass(frozen=True)
class ViewBatch:
    """B training views with their truth, in category units and radians."""

    points: Tensor
    """(B, n, 3) camera frame, random order."""
    labels: Tensor
    """(B, n) int64 part."""
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
    like, batch = bank.points, len(indices)
    objects = bank.scaled(indices, scale)
    states = sample_states(objects.limits, generator)

    identity = torch.eye(4, dtype=like.dtype, device=like.device).expand(batch, 4, 4)
    T_base_part = part_transforms(category.tree, objects.axes, objects.pivots, states, identity)
    points = _carry(T_base_part, objects.points, objects.labels)
    normals = _carry(T_base_part, objects.normals, objects.labels, direction=True)
    centre = torch.stack(bounding_box(points)).mean(0)
    radius = (points - centre[:, None]).norm(dim=-1).amax(-1)
    T_camera_base = sample_poses(category.views, centre, radius, generator)
    R, t = T_camera_base[:, :3, :3], T_camera_base[:, None, :3, 3]
    points, normals, centre = points @ R.mT + t, normals @ R.mT, (centre[:, None] @ R.mT + t).squeeze(1)

    level = uniform(0.0, settings.noise, (batch,), like, generator)
    level = level * (torch.rand(batch, device=like.device, generator=generator) < 0.5)
    cos_view = -(normals * points).sum(-1) / points.norm(dim=-1)
    seen = visible(points, centre, radius) & ((cos_view > 0) | ~objects.closed[:, None]) & _in_frame(points)
    seen &= (cos_view.abs() > np.cos(ON.grazing)) | (level == 0)[:, None]
    seen &= ~_holes(points, centre, radius, level, generator)

    # a random choice of the visible points; where there are too few, they repeat
    rank = torch.rand(seen.shape, device=like.device, generator=generator).masked_fill_(~seen, -1.0)
    slot = torch.arange(settings.points, device=like.device)[None] % seen.sum(1, keepdim=True).clamp(min=1)
    chosen = rank.topk(settings.points, dim=1).indices.gather(1, slot)
    picked = points.gather(1, chosen[..., None].expand(-1, -1, 3))
    picked = _add_noise(picked, level, category.metres_per_unit, generator)
    labels = objects.labels.gather(1, chosen)
    return ViewBatch(picked, labels, states, T_camera_base, objects.axes, objects.pivots, indices, scale)


def visible(points: Tensor, centre: Tensor, radius: Tensor) -> Tensor:
    """Point z-buffer: whether a point (B, S, 3) is the nearest of its image cell -> (B, S) bool. Cells are laid over
    the bounding sphere (``centre`` (B, 3), ``radius`` (B,), camera frame)."""
    depth, cells = points[..., 2], int(GRID * 1.3)
    half_extent = 1.3 * radius / centre[:, 2]  # perspective enlarges the near side of the sphere
    offset = points[..., :2] / depth[..., None] - (centre[:, :2] / centre[:, 2:])[:, None]
    column, row = ((offset / half_extent[:, None, None] + 1) * (cells / 2)).long().clamp(0, cells - 1).unbind(-1)
    cell = row * cells + column
    nearest = depth.new_full((len(points), cells * cells), torch.inf).scatter_reduce_(1, cell, depth, "amin")
    return depth <= nearest.gather(1, cell)


def _carry(T: Tensor, vectors: Tensor, labels: Tensor, direction: bool = False) -> Tensor:
    """Each vector (B, S, 3) by the transform T (B, K, 4, 4) of its part."""
    result = torch.zeros_like(vectors)
    for part in range(T.shape[1]):
        turned = vectors @ T[:, part, :3, :3].mT
        moved = turned if direction else turned + T[:, part, None, :3, 3]
        result = torch.where((labels == part)[..., None], moved, result)
    return result


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
