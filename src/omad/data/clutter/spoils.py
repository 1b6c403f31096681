"""The spoils, one by one: which places of B pictures they befall. Pure functions of places and a generator."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from omad.data.point_views import PERSPECTIVE
from omad.data.rendering.viewpoints import uniform

from .outline import ACROSS, Grid, Outline, sub_cells
from .regions import Boxes, smooth_field
from .settings import Clutter

NEAREST = 0.2
"""Category units; no depth is smaller."""
ENDLESS = 3.0
"""Radii of the bounding sphere: what is so long has no end in the picture."""
SPHERE = ACROSS / (2 * PERSPECTIVE)
"""Radius of the bounding sphere in sub-cells."""


@dataclass(frozen=True)
class Places:
    """N places in each of B pictures, and what is there."""

    at: Tensor
    """(B, N, 2) column and row in sub-cells."""
    rays: Tensor
    """(B, N, 2) x / z and y / z."""
    on_object: Tensor
    """(B, N) bool."""
    rim: Tensor
    """(B, N) bool: beside the outline, within or without."""
    edge_depth: Tensor
    """(B, N) of the object, or of its edge nearby."""
    in_mask: Tensor
    """(B, N) bool."""
    samples: Tensor
    """(B, n) bool: which of the first n places are points of the object."""

    @classmethod
    def of(cls, at: Tensor, samples: Tensor, grid: Grid, outline: Outline, in_mask: Tensor) -> Places:
        """``at`` (B, N, 2), the first n of which are places of the object's points where ``samples`` (B, n) says so;
        ``in_mask`` (B, ACROSS^2) bool of all sub-cells."""
        cell = sub_cells(at)
        steps = outline.steps.gather(1, cell)
        rim, depth = (steps >= 0) & (steps <= 1), outline.depth.gather(1, cell)
        return cls(at, grid.rays(at), steps <= 0, rim, depth, in_mask.gather(1, cell), samples)

    def drawn(self, low: float, high: float, generator: torch.Generator) -> Tensor:
        """(B, 1) uniform."""
        return uniform(low, high, (len(self.at), 1), self.at, generator)

    def happens(self, share: float, generator: torch.Generator) -> Tensor:
        """(B, 1) bool."""
        return self.drawn(0.0, 1.0, generator) < share

    def somewhere(self, generator: torch.Generator) -> Tensor:
        """(B, 2) a place of each object."""
        score = torch.rand(self.samples.shape, device=self.at.device, generator=generator).add_(self.samples)
        return self.at.gather(1, score.argmax(1)[:, None, None].expand(-1, -1, 2)).squeeze(1)

    def less_than_half(self, inside: Tensor) -> Tensor:
        """``inside`` (B, N), depth inside regions, turned inside out where one covers more than half of its object."""
        own = self.samples.shape[1]
        covered = ((inside[:, :own] > 0) & self.samples).sum(1, keepdim=True)
        return torch.where(2 * covered > self.samples.sum(1, keepdim=True), -inside, inside)


def mask_of(steps: Tensor, grid: Grid, clutter: Clutter, generator: torch.Generator) -> Tensor:
    """(B, ACROSS^2) bool: which sub-cells a mask takes in, of objects that are ``steps`` away. It is too wide, too
    narrow or right, perhaps more on one side, and perhaps shifted."""
    batch, pixel = len(steps), grid.pixel[:, None]

    def drawn(low: float, high: float, count: int = 1) -> Tensor:
        return uniform(low, high, (batch, count), steps, generator)

    wide = drawn(0, 1) < clutter.surrounded
    narrow = (drawn(0, 1) < clutter.eroded) & ~wide
    margin = torch.where(wide, drawn(*clutter.margin), torch.where(narrow, -drawn(*clutter.loss), 0.0)) * pixel
    shift = drawn(-clutter.shift, clutter.shift, 2) * pixel * (wide & (drawn(0, 1) < 0.5))
    line = torch.arange(ACROSS, device=steps.device, dtype=steps.dtype) + 0.5 - ACROSS / 2
    angle, uneven = drawn(0, 2 * math.pi), (drawn(0, 1) < 0.4) / SPHERE
    x, y = uneven * angle.cos() * line, uneven * angle.sin() * line
    margin = margin[:, None] * (1 + x[:, None] + y[:, :, None]).clamp_(0, 2)
    # a mask's edge lies anywhere in a sub-cell
    beyond = _shifted(steps.unflatten(1, (ACROSS, ACROSS)), shift.round().long())
    beyond -= torch.rand(beyond.shape, device=steps.device, generator=generator)
    return (beyond < margin).flatten(1)


def of_wrong_depth(
    places: Places, behind: Tensor, clutter: Clutter, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Where there is no point of the object though nothing is before it, (B, N), and the depth there: what is
    ``behind`` (B, N), something between that and the edge, or a patch of the object at a wrong depth."""
    drawn, happens = places.drawn, places.happens
    share = torch.rand(2, *behind.shape, device=behind.device, generator=generator)
    flying = places.rim & happens(clutter.flying, generator) & (share[0] < 0.4)
    between = places.edge_depth + (behind - places.edge_depth) * share[1]
    depth = torch.where(flying, between, behind)

    area = 4 * places.samples.sum(1, keepdim=True)  # sub-cells, four to a cell
    side = (area * drawn(*clutter.patch, generator)).sqrt() / 2
    aspect = drawn(0.6, 1.6, generator)
    half = torch.cat([side * aspect, side / aspect], 1) * happens(clutter.patched, generator)
    patch = Boxes(places.somewhere(generator), half, drawn(0, math.pi, generator).squeeze(1))
    patched = (patch.depth_inside(places.at) > 0) & places.on_object
    low, high = map(math.log, clutter.wrong)
    off = drawn(low, high, generator).exp()
    off = torch.where(happens(0.5, generator), off, -off)
    depth = torch.where(patched, (places.edge_depth + off).clamp(min=NEAREST), depth)
    return ~places.on_object | flying | patched, depth


def in_front(
    places: Places, centre: Tensor, clutter: Clutter, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Where something is before objects around ``centre`` (B, 3), (B, N), where of that it is in the mask, and its
    depth. A third each are as wide as long, bars, and edges beyond which nothing is seen."""
    drawn, happens = places.drawn, places.happens
    kind, angle = drawn(0, 3, generator), drawn(0, 2 * math.pi, generator)
    half = torch.cat([drawn(0.1, 0.35, generator), drawn(0.1, 0.35, generator)], 1)
    bar = torch.cat([torch.full_like(kind, ENDLESS), drawn(0.02, 0.1, generator)], 1)
    half = torch.where(kind < 1, bar, torch.where(kind > 2, ENDLESS, half)) * SPHERE
    away = ENDLESS * SPHERE * torch.cat([angle.cos(), angle.sin()], 1) * (kind > 2)
    box = Boxes(places.somewhere(generator) + away, half, angle.squeeze(1))
    inside = places.less_than_half(box.depth_inside(places.at))
    inside = torch.where(happens(clutter.occluded, generator), inside, -1.0)
    # seldom all of it
    width = torch.where(happens(0.15, generator), ACROSS, drawn(0.5, 3.0, generator))
    rim = inside < width * happens(clutter.rim, generator)
    depth = torch.minimum(centre[:, 2:] * drawn(0.55, 0.97, generator), 0.98 * places.edge_depth)
    return inside > 0, rim, depth


def out_of_sight(places: Places, clutter: Clutter, generator: torch.Generator) -> Tensor:
    """(B, N) what the image border cuts off, or blobs without measurement take away."""
    side = places.drawn(0, 4, generator).floor() * (math.pi / 2)
    middle = places.somewhere(generator) + ENDLESS * SPHERE * torch.cat([side.cos(), side.sin()], 1)
    border = Boxes(middle, torch.full_like(middle, ENDLESS * SPHERE), side.squeeze(1)).depth_inside(places.at)
    gone = (places.less_than_half(border) > 0) & places.happens(clutter.cut, generator)
    field = smooth_field(places.at, places.drawn(4.0, 15.0, generator).squeeze(1), generator)
    holes = (field > places.drawn(1.0, 2.0, generator)) & places.happens(clutter.blobs, generator)
    return gone | holes


def _shifted(image: Tensor, offset: Tensor) -> Tensor:
    """Pictures (B, H, W) moved by ``offset`` (B, 2) columns and rows; what comes in is their border's."""
    place = torch.arange(image.shape[1], device=image.device)
    column, row = ((place - offset[:, i, None]).clamp(0, len(place) - 1) for i in (0, 1))
    rows = image.gather(1, row[:, :, None].expand_as(image))
    return rows.gather(2, column[:, None].expand_as(image))
