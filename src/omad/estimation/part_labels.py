"""Which part every point of an observation belongs to, worked out when somebody asks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

OUTSIDE = -1
"""Label of a point that is not on the object."""


@dataclass(frozen=True, eq=False)
class LabelledPoints:
    """All points of an observation, some of which the network has labelled. Keeps the points in memory."""

    points: np.ndarray
    """(N, 3) float32."""
    seen: np.ndarray
    """(n,) which of them the network saw."""
    logits: np.ndarray
    """(n, K) of the parts, as it said, or (n, K + 1): the last of points that are not on the object."""
    parts: int
    """K."""

    @classmethod
    def none(cls) -> LabelledPoints:
        """Of no observation."""
        return cls(np.zeros((0, 3), np.float32), np.zeros(0, int), np.zeros((0, 1)), 1)

    @property
    def shares(self) -> np.ndarray:
        """(K,) of the points on the object that the network saw, those on each part; zeros where there are none."""
        counts = np.bincount(self.logits.argmax(-1), minlength=self.parts)[: self.parts]
        return counts / max(counts.sum(), 1)

    @cached_property
    def labels(self) -> np.ndarray:
        """(N,) part of every point: that of the nearest point that the network saw; ``OUTSIDE`` for those that are not
        on the object."""
        if not len(self.points):
            return np.zeros(0, int)
        from .nearest import nearest  # compiled only where it is used

        points = np.ascontiguousarray(self.points, dtype=np.float32)
        said = self.logits.argmax(-1)
        return np.where(said < self.parts, said, OUTSIDE)[nearest(points, points[self.seen])]
