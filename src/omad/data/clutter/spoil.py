"""Spoilt views: of every cell of the picture one point, on the object or on what got into its mask."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from omad.data.point_views import CELLS

from .outline import Grid, Outline
from .settings import Clutter
from .spoils import Places, in_front, mask_of, of_wrong_depth, out_of_sight
from .surroundings import background_depth

LEFT = 0.35
"""Share of the seen points of an object that a spoilt view leaves at least; else it stays as it was."""


@dataclass(frozen=True)
class SampledScene:
    """Samples of B posed objects, S each, before the camera."""

    points: Tensor
    """(B, S, 3) camera frame."""
    seen: Tensor
    """(B, S) bool: one at most of each cell."""
    labels: Tensor
    """(B, S) int64."""
    centre: Tensor
    """(B, 3) of the bounding sphere, camera frame."""
    radius: Tensor
    """(B,)."""
    T_camera_base: Tensor
    """(B, 4, 4)."""

    def floor(self) -> Tensor:
        """(B, 3) a point at the height of the object's lowest, camera frame."""
        base, up = self.T_camera_base[:, :3, 3], self.T_camera_base[:, :3, 1]
        height = (self.points @ up[..., None]).squeeze(-1).amin(1, keepdim=True)
        return base + up * (height - (base * up).sum(-1, keepdim=True))


def spoil(
    scene: SampledScene, spoilt: Tensor, clutter: Clutter, outside: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """One point a cell, (B, CELLS^2, 3), whether it is there, and its label, ``outside`` where it is not on the object.
    Views that are not ``spoilt`` (B,) keep what is seen of them."""
    grid = Grid.over(scene.centre, scene.radius)
    outline = Outline.of(scene.points, scene.seen, grid)
    there, owner = outline.owner >= 0, outline.owner.clamp(min=0)
    own = scene.points.gather(1, owner[..., None].expand(-1, -1, 3))
    labels = scene.labels.gather(1, owner)

    # beside each cell's point on the object a random place in it, in the mask where some of the cell is
    mask = mask_of(outline.steps, grid, clutter, generator)
    score = torch.rand(mask.shape, device=own.device, generator=generator).add_(mask)
    chosen = _by_cell(score).argmax(-1)
    cell = torch.arange(CELLS**2, device=own.device)
    corner = 2 * torch.stack([cell % CELLS, cell // CELLS], -1) + torch.stack([chosen % 2, chosen // 2], -1)
    random = corner + torch.rand(corner.shape, device=own.device, generator=generator)
    places = Places.of(torch.cat([grid.places(own), random], 1), there, grid, outline, mask)
    behind = background_depth(
        places.rays, places.edge_depth, scene.centre, scene.T_camera_base[:, :3, 1], scene.floor(), clutter, generator
    )
    foreign, depth = of_wrong_depth(places, behind, clutter, generator)
    covered, rim, near = in_front(places, scene.centre, clutter, generator)
    kept = places.in_mask & (~covered | rim) & ~out_of_sight(places, clutter, generator)
    foreign, depth = foreign | covered, torch.where(covered, near, depth)

    mine, strange = (kept & ~foreign)[:, : CELLS**2], (kept & foreign)[:, CELLS**2 :]
    mine &= there & ~strange
    spoilt = (spoilt & (mine.sum(1) > LEFT * there.sum(1)))[:, None]
    mine, strange = torch.where(spoilt, mine, there), strange & spoilt
    ray, depth = places.rays[:, CELLS**2 :], depth[:, CELLS**2 :, None]
    points = torch.where(strange[..., None], torch.cat([ray * depth, depth], -1), own)
    return points, mine | strange, torch.where(strange, outside, labels)


def _by_cell(image: Tensor) -> Tensor:
    """(B, CELLS^2, 4) the sub-cells (B, ACROSS^2) of each cell, row by row."""
    return image.unflatten(1, (CELLS, 2, CELLS, 2)).transpose(2, 3).flatten(3, 4).flatten(1, 2)
