"""Surface samples posed and looked at: what of them a camera sees.

On the CPU in compiled loops (``view_kernels``), elsewhere in the plain PyTorch that the tests hold them to. Lengths in
category units.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from omad.geometry.transforms import bounding_box, transform_points

from . import view_kernels
from .surface_bank import SurfaceBank

PERSPECTIVE = 1.3
"""Half the width of the point z-buffer in radii of the bounding sphere, whose near side perspective enlarges."""
CELLS = int(48 * PERSPECTIVE)
"""Across the point z-buffer."""


@dataclass(frozen=True)
class PosedSamples:
    """Samples of B objects, S each, posed, in the base frame."""

    points: Tensor
    """(B, S, 3)."""
    normals: Tensor
    """(B, S, 3) unit."""
    centre: Tensor
    """(B, 3) of the bounding sphere, which is that of the box."""
    radius: Tensor
    """(B,)."""


def pose(bank: SurfaceBank, indices: Tensor, scale: Tensor, T_base_part: Tensor) -> PosedSamples:
    """The objects ``indices`` (B,), stretched by ``scale`` (B, 3), with their parts where ``T_base_part`` (B, K, 4, 4)
    puts them."""
    if bank.points.device.type != "cpu":
        return plain_pose(bank, indices, scale, T_base_part)
    new = bank.points.new_empty
    points, centre = new(len(indices), *bank.points.shape[1:]), new(len(indices), 3)
    posed = PosedSamples(points, torch.empty_like(points), centre, new(len(indices)))
    given = bank.points, bank.normals, bank.labels, indices, scale, T_base_part.contiguous()
    view_kernels.pose(*(tensor.numpy() for tensor in (*given, *vars(posed).values())))
    return posed


def plain_pose(bank: SurfaceBank, indices: Tensor, scale: Tensor, T_base_part: Tensor) -> PosedSamples:
    """``pose`` on any device."""
    objects = bank.scaled(indices, scale)
    points = _carry(T_base_part, objects.points, objects.labels)
    normals = _carry(T_base_part, objects.normals, objects.labels, direction=True)
    centre = torch.stack(bounding_box(points)).mean(0)
    return PosedSamples(points, normals, centre, (points - centre[:, None]).norm(dim=-1).amax(-1))


def look(posed: PosedSamples, closed: Tensor, T_camera_base: Tensor, steepest: Tensor) -> tuple[Tensor, Tensor]:
    """Samples in the camera frame (B, S, 3), and whether they can be seen from there if nothing hides them, (B, S):
    they face the camera, where the surface is ``closed`` (B,), and at no smaller cosine than ``steepest`` (B,). On the
    CPU ``posed.points`` are moved in place."""
    if posed.points.device.type != "cpu":
        return plain_look(posed, closed, T_camera_base, steepest)
    facing = torch.empty(posed.points.shape[:2], dtype=torch.bool)
    given = posed.points, posed.normals, closed, T_camera_base.contiguous(), steepest, facing
    view_kernels.look(*(tensor.numpy() for tensor in given))
    return posed.points, facing


def plain_look(posed: PosedSamples, closed: Tensor, T_camera_base: Tensor, steepest: Tensor) -> tuple[Tensor, Tensor]:
    """``look`` on any device."""
    points = transform_points(T_camera_base, posed.points)
    cosine = -(posed.normals @ T_camera_base[:, :3, :3].mT * points).sum(-1) / points.norm(dim=-1)
    return points, ((cosine > 0) | ~closed[:, None]) & (cosine.abs() > steepest[:, None])


def visible(points: Tensor, centre: Tensor, radius: Tensor) -> Tensor:
    """Point z-buffer: whether a point (B, S, 3) is the nearest of its image cell -> (B, S) bool. Cells are laid over
    the bounding sphere (``centre`` (B, 3), ``radius`` (B,), camera frame)."""
    if points.device.type != "cpu":
        return plain_visible(points, centre, radius)
    seen = torch.empty(points.shape[:2], dtype=torch.bool)
    half_extent = PERSPECTIVE * radius / centre[:, 2]
    given = points.numpy(), centre.numpy(), half_extent.numpy()
    view_kernels.nearest_of_cell(*given, CELLS, seen.numpy())
    return seen


def plain_visible(points: Tensor, centre: Tensor, radius: Tensor) -> Tensor:
    """``visible`` on any device."""
    depth, half_extent = points[..., 2], PERSPECTIVE * radius / centre[:, 2]
    offset = points[..., :2] / depth[..., None] - (centre[:, :2] / centre[:, 2:])[:, None]
    column, row = ((offset / half_extent[:, None, None] + 1) * (CELLS / 2)).long().clamp(0, CELLS - 1).unbind(-1)
    cell = row * CELLS + column
    nearest = depth.new_full((len(points), CELLS * CELLS), torch.inf).scatter_reduce_(1, cell, depth, "amin")
    return depth <= nearest.gather(1, cell)


def _carry(T: Tensor, vectors: Tensor, labels: Tensor, direction: bool = False) -> Tensor:
    """Each vector (B, S, 3) by the transform T (B, K, 4, 4) of its part."""
    result = torch.zeros_like(vectors)
    for part in range(T.shape[1]):
        turned = vectors @ T[:, part, :3, :3].mT
        moved = turned if direction else turned + T[:, part, None, :3, 3]
        result = torch.where((labels == part)[..., None], moved, result)
    return result
