"""The picture of an object in the cells of the point z-buffer, each of them in four: where it is, where it ends.

On the CPU in compiled loops (``kernels``), elsewhere in the plain PyTorch that the tests hold them to.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from omad.data.point_views import CELLS, PERSPECTIVE
from omad.geometry.camera import STANDARD_CAMERA

from . import kernels

ACROSS = 2 * CELLS
"""Sub-cells across the picture, two to a cell."""
REACH = 5
"""Sub-cells up to which distances from the outline are told, 9 pixels of a small object in a standard view."""


@dataclass(frozen=True)
class Grid:
    """Where the sub-cells of B pictures lie."""

    middle: Tensor
    """(B, 2) x / z and y / z."""
    half: Tensor
    """(B,) half the width, in the same measure."""

    @classmethod
    def over(cls, centre: Tensor, radius: Tensor) -> Grid:
        """The point z-buffer's, over bounding spheres: ``centre`` (B, 3) in the camera frame, ``radius`` (B,)."""
        return cls(centre[:, :2] / centre[:, 2:], PERSPECTIVE * radius / centre[:, 2])

    @property
    def pixel(self) -> Tensor:
        """(B,) sub-cells in a pixel of the standard camera."""
        return ACROSS / (2 * self.half * STANDARD_CAMERA.fx)

    def places(self, points: Tensor) -> Tensor:
        """(B, N, 2) column and row, in sub-cells from the corner, of points (B, N, 3)."""
        rays = points[..., :2] / points[..., 2:]
        return ((rays - self.middle[:, None]) / self.half[:, None, None] + 1) * (ACROSS / 2)

    def rays(self, places: Tensor) -> Tensor:
        """(B, N, 2) x / z and y / z of ``places`` (B, N, 2)."""
        return (places * (2 / ACROSS) - 1) * self.half[:, None, None] + self.middle[:, None]


def sub_cells(places: Tensor) -> Tensor:
    """(B, N) which sub-cell each of ``places`` (B, N, 2) lies in, row by row."""
    column, row = places.long().clamp_(0, ACROSS - 1).unbind(-1)
    return row * ACROSS + column


@dataclass(frozen=True)
class Outline:
    """Of B objects."""

    depth: Tensor
    """(B, ACROSS^2) of the object in each sub-cell; for ``REACH`` of them beyond its outline that of its nearest edge,
    then infinite."""
    steps: Tensor
    """(B, ACROSS^2) distance from the outline in sub-cells: 1 just outside and growing, 0 on the rim and falling
    inward; no more than ``REACH`` + 1, no less than -``REACH``."""
    owner: Tensor
    """(B, CELLS^2) int64: which sample is seen in each cell, -1 for none."""

    @classmethod
    def of(cls, points: Tensor, seen: Tensor, grid: Grid) -> Outline:
        """Of samples (B, S, 3) in the camera frame, hidden ones too, of which those ``seen`` (B, S) are one a cell at
        most. Gaps of a sub-cell are closed."""
        if points.device.type != "cpu":
            return plain_outline(points, seen, grid)
        batch, new = len(points), points.new_empty
        outline = cls(new(batch, ACROSS**2), new(batch, ACROSS**2), torch.empty(batch, CELLS**2, dtype=torch.int64))
        given = points.contiguous(), seen, grid.middle.contiguous(), grid.half
        kernels.outline(*(tensor.numpy() for tensor in (*given, *vars(outline).values())), ACROSS, REACH)
        return outline


def plain_outline(points: Tensor, seen: Tensor, grid: Grid) -> Outline:
    """``Outline.of`` on any device."""
    own = sub_cells(grid.places(points))
    cell = (own // (2 * ACROSS)) * CELLS + (own % ACROSS) // 2
    batch, count = seen.shape
    # samples that are not seen go where nobody looks
    owner = own.new_full((batch, CELLS**2 + 1), -1)
    owner.scatter_(1, cell.where(seen, CELLS**2), torch.arange(count, device=own.device).expand(batch, -1))

    nearness = points.new_zeros(batch, ACROSS**2).scatter_reduce_(1, own, 1 / points[..., 2], "amax")
    nearness = nearness.unflatten(1, (ACROSS, ACROSS))
    grown = _highest(nearness)
    nearness = torch.where(nearness > 0, nearness, grown * -_highest(-(grown > 0).to(grown)))
    inside = nearness > 0
    steps = torch.where(inside, -float(REACH), REACH + 1.0)
    for step in range(1, REACH + 1):
        wider = _highest(nearness)
        steps[(wider > 0) & (nearness == 0)] = step
        nearness = torch.where(nearness > 0, nearness, wider)
    for step in range(REACH):
        thinner = -_highest(-inside.to(steps)) > 0
        steps[inside & ~thinner] = -step
        inside = thinner
    return Outline((1 / nearness).flatten(1), steps.flatten(1), owner[:, :-1])


def _highest(image: Tensor) -> Tensor:
    """(B, H, W) the highest value of each place's 3 x 3 neighbours; borders have fewer."""
    return torch.nn.functional.max_pool2d(image[:, None], 3, 1, 1).squeeze(1)
