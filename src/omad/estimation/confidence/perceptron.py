"""A small function from signals to a few numbers: a linear one, and a hidden layer for what depends on two at once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

Row = tuple[float, ...]

FARTHEST = 4.0
"""Standard deviations from the mean beyond which an input says no more."""


@dataclass(frozen=True)
class Perceptron:
    """(N,) -> (K,) over H hidden units; plain numbers, as a JSON file keeps them."""

    mean: Row
    """(N,) of the inputs."""
    spread: Row
    """(N,) their standard deviations."""
    hidden: tuple[Row, ...]
    """(H, N + 1), the last column its bias."""
    bent: tuple[Row, ...]
    """(K, H) what the hidden units add."""
    straight: tuple[Row, ...]
    """(K, N + 1) the linear function, the last column its bias."""

    def __post_init__(self) -> None:
        inputs, hidden = len(self.mean), len(self.hidden)
        lengths = [("spread", [self.spread], inputs), ("hidden", self.hidden, inputs + 1)]
        lengths += [("bent", self.bent, hidden), ("straight", self.straight, inputs + 1)]
        for name, rows, length in lengths:
            if any(len(row) != length for row in rows):
                raise ValueError(f"{name}: does not go with the others; give rows of {length} numbers")
        if len(self.bent) != len(self.straight):
            raise ValueError("bent: does not go with straight; give as many rows")

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Of inputs (..., N) -> (..., K)."""
        mean, spread, hidden, bent, straight = self._arrays
        x = np.clip((inputs - mean) / spread, -FARTHEST, FARTHEST)
        inner = np.tanh(x @ hidden[:, :-1].T + hidden[:, -1])
        return inner @ bent.T + x @ straight[:, :-1].T + straight[:, -1]

    @cached_property
    def _arrays(self) -> tuple[np.ndarray, ...]:
        fields = (self.mean, self.spread, self.hidden, self.bent, self.straight)
        return tuple(np.array(values, dtype=float) for values in fields)
