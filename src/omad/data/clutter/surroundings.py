"""What is behind an object: the table it stands on, a wall, something beside it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from omad.data.rendering.viewpoints import uniform

from .settings import Clutter

TILT = 0.7
"""Of a wall: how much its depth changes to the side, at most, per length."""
GAP = 0.003
"""By how much of its distance the background is behind the object's edge at least."""


def plane_depth(rays: Tensor, normal: Tensor, through: Tensor) -> Tensor:
    """(B, N) depth where ``rays`` (B, N, 2), x / z and y / z, meet planes with ``normal`` (B, 3) through points (B, 3),
    camera frame; infinite where they do not, in front of the camera."""
    per_depth = (rays @ normal[:, :2, None]).squeeze(-1) + normal[:, 2:]
    depth = (normal * through).sum(-1, keepdim=True) / per_depth
    return depth.masked_fill_(~(depth > 0), torch.inf)


def background_depth(
    rays: Tensor, edge: Tensor, centre: Tensor, up: Tensor, floor: Tensor, clutter: Clutter,
    generator: torch.Generator,
) -> Tensor:  # fmt: skip
    """(B, N) depth of what is behind objects around ``centre`` (B, 3), camera frame, on ``rays`` (B, N, 2): of half of
    them the table that they stand on, through ``floor`` (B, 3) and across ``up`` (B, 3), with a wall behind it; of the
    others the wall alone, or something beside them. Unless it is beside, it is never nearer than the object's ``edge``
    (B, N)."""
    batch = len(centre)

    def drawn(low: float, high: float, *shape: int) -> Tensor:
        return uniform(low, high, (batch, *shape), centre, generator)

    table = plane_depth(rays, up, floor - up * drawn(0.0, 0.03, 1)).masked_fill_(drawn(0.0, 1.0, 1) < 0.5, torch.inf)
    beside = drawn(0.0, 1.0) < clutter.beside
    low, high = map(math.log, clutter.distance)
    behind = torch.where(beside, drawn(-0.2, 0.2), drawn(low, high).exp())
    facing = torch.cat([drawn(-TILT, TILT, 2), -torch.ones_like(centre[:, 2:])], 1)
    wall = plane_depth(rays, facing, centre * (1 + behind[:, None]))
    wall = torch.minimum(wall, 3 * centre[:, 2:])
    limit = torch.where(edge.isfinite() & ~beside[:, None], edge * (1 + GAP), 0.0)
    return torch.maximum(torch.minimum(table, wall), limit)
