"""What is believed of an object's shape after some frames of it.

Frames from one viewpoint err alike, so that ten of them say hardly more than one. A frame's information therefore
counts by how far the view moved since the last one, and altogether no more than a few independent views are counted.
"""

from dataclasses import dataclass

import numpy as np

from omad.common.errors import InputError
from omad.estimation.known import information


@dataclass(frozen=True)
class ShapeConfig:
    """How much frames tell."""

    new_view: float = 0.5
    """Radians that the base turns before the camera (or a joint moves) until a frame tells something new."""
    most_views: float = 6.0
    """The belief never counts more independent views than this; older ones are forgotten for newer ones."""

    def __post_init__(self) -> None:
        if not (self.new_view > 0 and self.most_views >= 1):
            raise InputError("ShapeConfig: new_view must be above 0, and most_views at least 1")


class ShapeBelief:
    """A Gaussian over beta (D,), at first the category's."""

    def __init__(self, config: ShapeConfig, mean: np.ndarray, covariance: np.ndarray) -> None:
        self.config, self.mean, self.covariance = config, mean, covariance
        self.views = 0.0
        """Independent views counted so far."""
        self._prior = self._belief = _natural(mean, covariance)

    def count(self, moved: float) -> float:
        """The share of a new view that a frame is whose view moved by so many radians since the last frame."""
        return 1.0 if self.views == 0 else 1 - float(np.exp(-moved / self.config.new_view))

    def update(self, mean: np.ndarray, covariance: np.ndarray, share: float, cold: bool = False) -> None:
        """Take in the posterior of a frame, counted by ``share``. Its prior was this belief, or the category's where it
        was a ``cold`` start's."""
        if share <= 0 or not np.isfinite(covariance).all():
            return
        seen = _natural(mean, covariance) - (self._prior if cold else self._belief)  # what the frame alone has said
        kept = min(1.0, (self.config.most_views - share) / max(self.views, 1e-9))
        self.views = kept * self.views + share
        self._belief = self._prior + kept * (self._belief - self._prior) + share * seen
        covariance = np.linalg.inv(self._belief[:, :-1])
        self.covariance = (covariance + covariance.T) / 2
        self.mean = self.covariance @ self._belief[:, -1]


def _natural(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(D, D + 1) information matrix and vector of a Gaussian."""
    precision = information(covariance)
    return np.c_[precision, precision @ mean]
