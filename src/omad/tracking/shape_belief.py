"""What is believed of an object's shape after some frames of it.

Frames from one viewpoint err alike, so that ten of them say hardly more than one. A frame's information therefore
counts by how far the view moved since the last one, and altogether no more than a few independent views are counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ShapeConfig:
    """How much frames tell."""

    new_view: float = 0.5
    """Radians that the base turns before the camera (or a joint moves) until a frame tells something new."""
    most_views: float = 6.0
    """The belief never counts more independent views than this; older ones are forgotten for newer ones."""


class ShapeBelief:
    """A Gaussian over beta (D,), at first the category's."""

    def __init__(self, config: ShapeConfig, mean: np.ndarray, covariance: np.ndarray) -> None:
        self.config = config
        self.mean, self.covariance = mean, covariance
        self.views = 0.0
        """Independent views counted so far."""
        self._prior = self._information, self._vector = _natural(mean, covariance)

    def count(self, moved: float) -> float:
        """The share of a new view that a frame is whose view moved by so many radians since the last frame."""
        return 1.0 if self.views == 0 else 1 - float(np.exp(-moved / self.config.new_view))

    def update(self, mean: np.ndarray, covariance: np.ndarray, share: float) -> None:
        """Take in the posterior of a frame that was estimated with this belief as its prior, counted by ``share``."""
        if share <= 0 or not np.isfinite(covariance).all():
            return
        information, vector = _natural(mean, covariance)
        seen = information - self._information, vector - self._vector  # what the frame alone has said
        kept = min(1.0, (self.config.most_views - share) / max(self.views, 1e-9))
        self.views = kept * self.views + share
        category = self._prior
        self._information = category[0] + kept * (self._information - category[0]) + share * seen[0]
        self._vector = category[1] + kept * (self._vector - category[1]) + share * seen[1]
        self.covariance = np.linalg.inv(self._information)
        self.covariance = (self.covariance + self.covariance.T) / 2
        self.mean = self.covariance @ self._vector


def _natural(mean: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information matrix and vector of a Gaussian."""
    information = np.linalg.inv(covariance)
    return information, information @ mean
