"""Which points of clouds the network is shown: at first any, then without those that it says are not on the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from omad.common.errors import InputError, NothingSeen
from omad.model.network_input import sample_clouds
from omad.objects.category import Category
from omad.sensing.observation import FARTHEST, MIN_POINTS, Observation

from ..part_labels import OUTSIDE, LabelledPoints

SURE = 1.0
"""By how much the logit of a point outside the object must exceed its others to speak against the mask: training counts
such points three times, so less may be found on any object."""
FEW = 0.01
"""Share of such points that a look does well with."""
LEFT = 0.2
"""Share of an observation's points that must be on the object: where there are fewer, it was not found."""


@dataclass(frozen=True)
class Shown:
    """Random choices of the points of B clouds."""

    observations: Sequence[Observation]
    category: Category
    clouds: Tensor
    """(B, samples, n, 3) category units."""
    chosen: list[np.ndarray]
    """(samples * n,) which points of the observation these are."""
    first: dict[int, LabelledPoints] = field(default_factory=dict)
    """What was said of the clouds that points were left out of, before that."""

    @classmethod
    def of(
        cls, observations: Sequence[Observation], points: int, samples: int, seed: int, category: Category,
        device: torch.device,
    ) -> Shown:  # fmt: skip
        """``samples`` choices of ``points`` each."""
        clouds, chosen = sample_clouds(observations, points, samples, seed, category, device)
        return cls(observations, category, clouds, chosen)

    def crowded(self, logits: np.ndarray) -> list[int]:
        """Clouds with other things than the object, given what was said of their first points, (B, n, K + 1)."""
        margin = logits[..., -1] - logits[..., :-1].max(-1)
        return np.flatnonzero((margin > SURE).mean(1) > FEW).tolist()

    def without_outside(self, rows: Sequence[int], logits: np.ndarray, seed: int) -> Shown:
        """Instead of the clouds ``rows`` choices of those of their points whose nearest neighbour among the labelled is
        on the object. ``logits`` (len(rows), samples * n, K + 1) are of all choices."""
        first, kept = {}, {}
        for b, said in zip(rows, logits, strict=True):
            seen = self._labelled(b, self.chosen[b], said)
            inside = np.flatnonzero(seen.labels != OUTSIDE)
            if len(inside) >= max(MIN_POINTS, LEFT * len(seen.points)):
                first[b], kept[b] = seen, inside
        if not kept:
            return self
        cleaned = [replace(self.observations[b], points=self.observations[b].points[some]) for b, some in kept.items()]
        samples, points = self.clouds.shape[1:3]
        clouds, again = sample_clouds(cleaned, points, samples, seed, self.category, self.clouds.device)
        chosen = list(self.chosen)
        for (b, inside), index in zip(kept.items(), again, strict=True):
            chosen[b] = inside[index]
        clouds = self.clouds.index_copy(0, torch.tensor(list(kept), device=clouds.device), clouds)
        return replace(self, clouds=clouds, chosen=chosen, first=first)

    def with_rows_of(self, other: Shown, rows: Sequence[int]) -> Shown:
        """With what ``other`` has of the clouds ``rows``."""
        chosen, clouds = list(self.chosen), self.clouds.clone()
        for b in rows:
            chosen[b], clouds[b] = other.chosen[b], other.clouds[b]
        first = {b: said for b, said in self.first.items() if b not in rows}
        first |= {b: said for b, said in other.first.items() if b in rows}
        return replace(self, clouds=clouds, chosen=chosen, first=first)

    def labelled(self, b: int, logits: np.ndarray) -> LabelledPoints:
        """Cloud ``b`` with what the last look said of its points, ``logits`` (m, K) or (m, K + 1), and of points that
        it was not shown what was said before."""
        last = self._labelled(b, self.chosen[b][-len(logits) :], logits)
        if (first := self.first.get(b)) is None:
            return last
        outside = first.logits.argmax(-1) == first.parts
        seen = np.concatenate([first.seen[outside], last.seen])
        return replace(last, seen=seen, logits=np.concatenate([first.logits[outside], last.logits]))

    def _labelled(self, b: int, seen: np.ndarray, logits: np.ndarray) -> LabelledPoints:
        return LabelledPoints(self.observations[b].points, seen, logits, len(self.category.parts))


def check_observations(observations: Any) -> list[Observation]:
    """All of a sequence. Raises InputError that tells which of them is none, or holds points that are no places,
    or none that a camera sees; NothingSeen where one has fewer than 50."""
    if not isinstance(observations, Sequence):
        raise InputError(f"observation: is {type(observations).__name__}; give an omad.Observation, or a list of them")
    for index, one in enumerate(observations):
        cloud = getattr(one, "points", None)
        if not isinstance(cloud, np.ndarray) or cloud.dtype.kind != "f" or cloud.shape[1:] != (3,):
            raise InputError(f"observation {index}: has no points (N, 3); make it with Observation.from_depth")
        if len(cloud) < MIN_POINTS:
            raise NothingSeen(f"observation {index}: {len(cloud)} points, at least {MIN_POINTS} are needed")
        if not max(-cloud.min(), cloud.max()) <= FARTHEST:  # not for NaN either
            raise InputError(f"observation {index}: has points that are not finite, or too far away; leave them out")
        if np.count_nonzero(cloud[:, 2] <= 0) > len(cloud) / 2:  # of who made it without from_points, which says more
            raise InputError(f"observation {index}: most of its points lie behind the camera; turn z forward")
    return list(observations)
