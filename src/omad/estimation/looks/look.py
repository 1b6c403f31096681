"""What the network says of clouds in one look at them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from omad.model.fitting.state import State, Targets
from omad.model.omadnet import Prediction

from .shown import Shown


@dataclass(frozen=True)
class Look:
    """One look at B clouds, in the camera frame and category units."""

    targets: Targets
    said: Prediction
    """Of the samples of all clouds, in their frames."""
    samples: int
    frame: Tensor
    """T_camera_input (B, 4, 4)."""

    @property
    def state(self) -> State:
        """What the network itself says of the unknowns."""
        beta, states = (
            values.unflatten(0, (-1, self.samples)).mean(1) for values in (self.said.beta, self.said.states)
        )
        return State(beta, states, self.frame @ self.said.T_input_base[:: self.samples])

    @property
    def expected_error(self) -> Tensor:
        """(B,) of keypoints, geometric mean."""
        return (-0.5 * self.targets.weights.log().mean(1)).exp()

    @property
    def part_logits(self) -> Tensor:
        """(B, n, K), or K + 1 where the network tells points outside the object."""
        return self.said.part_logits.unflatten(0, (-1, self.samples)).flatten(1, 2)

    def of(self, rows: Tensor) -> Look:
        """What is seen of the clouds ``rows``."""
        said = rows_of(self.said, _samples_of(rows, self.samples))
        return replace(self, targets=rows_of(self.targets, rows), said=said, frame=self.frame[rows])

    def with_rows(self, rows: Tensor, other: Look) -> Look:
        """With what ``other`` has seen of the clouds ``rows``."""
        said = with_rows(self.said, _samples_of(rows, self.samples), other.said)
        targets = with_rows(self.targets, rows, other.targets)
        return replace(self, targets=targets, said=said, frame=self.frame.index_copy(0, rows, other.frame))


@dataclass(frozen=True)
class Crowd:
    """Clouds with other things than the object, which were left out."""

    rows: Tensor
    """(n,) which clouds."""
    shown: Shown
    """All clouds with these things."""
    look: Look
    """The first at the clouds ``rows``, with these things."""


def _samples_of(rows: Tensor, samples: int) -> Tensor:
    """Where the samples of the clouds ``rows`` lie among those of all."""
    return (rows[:, None] * samples + torch.arange(samples, device=rows.device)).flatten()


def rows_of(found: Any, rows: Tensor) -> Any:
    """Some rows of a dataclass of tensors, or of such."""
    values = {
        key: value[rows] if isinstance(value, Tensor) else rows_of(value, rows) for key, value in vars(found).items()
    }
    return replace(found, **values)


def with_rows(found: Any, rows: Tensor, others: Any) -> Any:
    """A dataclass of tensors, or of such, with some rows replaced."""
    values = {
        key: value.index_copy(0, rows, other) if isinstance(value, Tensor) else with_rows(value, rows, other)
        for key, value, other in ((key, value, getattr(others, key)) for key, value in vars(found).items())
    }
    return replace(found, **values)
