"""Shapes in pictures: rectangles, and smooth random fields."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

LATTICE = 64
"""Random numbers across a smooth field."""


@dataclass(frozen=True)
class Boxes:
    """B turned rectangles in sub-cells of pictures."""

    middle: Tensor
    """(B, 2) column and row."""
    half: Tensor
    """(B, 2) half its length and width."""
    angle: Tensor
    """(B,)."""

    def depth_inside(self, places: Tensor) -> Tensor:
        """(B, N): how deep inside its box each of ``places`` (B, N, 2) is, negative outside."""
        x, y = (places - self.middle[:, None]).unbind(-1)
        cosine, sine = self.angle.cos()[:, None], self.angle.sin()[:, None]
        along, across = (cosine * x + sine * y).abs(), (cosine * y - sine * x).abs()
        return torch.minimum(self.half[:, :1] - along, self.half[:, 1:] - across)


def smooth_field(places: Tensor, spacing: Tensor, generator: torch.Generator) -> Tensor:
    """(B, N) of about unit variance and mean zero, at ``places`` (B, N, 2): a lattice of random numbers, ``spacing``
    (B,) apart, blended between them; it repeats after ``LATTICE`` - 1 of them."""
    lattice = places.new_empty(len(places), 1, LATTICE, LATTICE).normal_(generator=generator)
    lattice[..., -1, :] = lattice[..., 0, :]
    lattice[..., -1] = lattice[..., 0]
    at = torch.remainder(places / spacing[:, None, None], LATTICE - 1) * (2 / (LATTICE - 1)) - 1
    # where four numbers are blended, variance is 4/9 on average
    return 1.5 * grid_sample(lattice, at[:, :, None], align_corners=True).flatten(1)
