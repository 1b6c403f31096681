"""Part-labelled surface samples of many objects: what all trainings draw from, on their device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from omad.common.errors import InputError
from omad.objects.category import Category
from omad.objects.model import SampledObject


@dataclass(frozen=True)
class Joints:
    """Of B objects, canonical space and category units."""

    axes: Tensor
    """(B, J, 3) unit."""
    pivots: Tensor
    """(B, J, 3)."""
    limits: Tensor
    """(B, J, 2) radians or category units."""


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
        """Sample every model; the same seed gives the same bank. Raises InputError for models of the other hand."""
        for model in models if category.either_hand else ():
            if (model.axes * category.axes).sum(1).min() < 0:
                cure = "give a source of objects of its own, or their mirror images"
                raise InputError(f"{model.name}: is of the other hand than {category.name}'s prior knows; {cure}")
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
        return SurfaceBank(**{f.name: getattr(self, f.name).to(device) for f in fields(SurfaceBank)})

    def scaled(self, indices: Tensor, scale: Tensor) -> SurfaceBank:
        """Objects ``indices`` (B,) stretched by ``scale`` (B, 3) along the canonical axes, joints along with them."""
        joints, stretch = self.joints(indices, scale), scale[:, None]
        points, normals = self.points[indices] * stretch, normalize(self.normals[indices] / stretch, dim=-1)
        labels, closed = self.labels[indices], self.closed[indices]
        return SurfaceBank(points, normals, labels, joints.axes, joints.pivots, joints.limits, closed)

    def joints(self, indices: Tensor, scale: Tensor) -> Joints:
        """Those of the objects ``indices`` (B,) stretched by ``scale`` (B, 3), between the limits that they had."""
        stretch = scale[:, None]
        axes = normalize(self.axes[indices] * stretch, dim=-1)
        return Joints(axes, self.pivots[indices] * stretch, self.limits[indices])


@dataclass(frozen=True)
class PartSamples:
    """The samples of a bank by part, to draw as many of each."""

    points: Tensor
    """(N, S, 3) one part's after the other's."""
    first: Tensor
    """(N, K) where each part's begin."""
    count: Tensor
    """(N, K) how many there are."""

    @classmethod
    def of(cls, bank: SurfaceBank, parts: int) -> PartSamples:
        order = bank.labels.argsort(dim=1, stable=True)
        count = torch.stack([(bank.labels == part).sum(1) for part in range(parts)], 1)
        return cls(bank.points.gather(1, order[..., None].expand_as(bank.points)), count.cumsum(1) - count, count)

    def draw(self, indices: Tensor, scale: Tensor, each: int, generator: torch.Generator) -> list[Tensor]:
        """So many random points (B, each, 3) of every part of the objects ``indices`` (B,), stretched by ``scale``
        (B, 3) along the canonical axes."""
        drawn = torch.rand(self.count.shape[1], len(indices), each, device=scale.device, generator=generator)
        place = (drawn * self.count[indices].T[..., None]).long() + self.first[indices].T[..., None]
        return list(self.points[indices[:, None], place] * scale[:, None])
