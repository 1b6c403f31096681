"""Lens distortion: where a pinhole camera's ray is seen (forward, every model in closed form), and back (by Newton's
method). Rays and places are (x, y) = (X / Z, Y / Z): pixels without focal length and principal point."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from omad.common.errors import InputError

MAX_STEPS = 20
CLOSE = 1e-9
"""Of a seen place to the one asked for: a millionth of a pixel."""
STEP = 1e-6
"""Of the difference quotient."""
FARTHEST, SAMPLES = 10.0, 20_001
"""Up to where a fold is looked for, and at how many places: nothing is seen 84 degrees beside the axis."""


@dataclass(frozen=True)
class Distortion:
    """A lens, by the names and coefficients that camera drivers use. ``plumb_bob`` (k1, k2, p1, p2[, k3]),
    ``rational_polynomial`` (k1, k2, p1, p2, k3, k4, k5, k6) and ``equidistant`` (k1, k2, k3, k4) are those of ROS and
    OpenCV; ``brown_conrady``, ``modified_brown_conrady``, ``inverse_brown_conrady`` (k1, k2, p1, p2, k3) and
    ``kannala_brandt4`` (k1, k2, k3, k4) those of librealsense. Raises InputError for other models and for coefficients
    that are too many or no numbers."""

    model: str
    """One of those above."""
    coefficients: tuple[float, ...]
    """In the order above."""

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"distortion model {self.model!r}: is unknown; known ones are {', '.join(MODELS)}")
        given, size = np.array(np.nan), MODELS[self.model][1]
        with suppress(TypeError, ValueError):  # of texts and of ragged lists
            given = np.asarray(self.coefficients, dtype=np.float64)
        if given.ndim != 1 or not np.isfinite(given).all() or given[size:].any():
            raise InputError(f"distortion {self.model}: {self.coefficients}: give at most {size} finite numbers")
        object.__setattr__(self, "coefficients", tuple(given.tolist()))  # hashable

    def distort(self, rays: np.ndarray) -> np.ndarray:
        """Where rays (N, 2) are seen (N, 2)."""
        k = np.array([*self.coefficients, *[0] * 8][:8], dtype=np.float64)
        return np.stack(MODELS[self.model][0](rays[:, 0], rays[:, 1], k), 1)

    @cached_property
    def fold(self) -> float:
        """Length of rays (tangent of their angle to the axis) up to which the model holds: beyond, polynomials lead
        back to the image's middle, where no lens shows them. Infinite where they do not."""
        lengths, found = np.linspace(0, FARTHEST, SAMPLES)[1:], np.inf
        for way in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            back = np.diff(self.distort(np.outer(lengths, way)) @ way) <= 0
            if back.any():
                found = min(found, float(lengths[back.argmax()]))
        return found

    def undistort(self, seen: np.ndarray) -> np.ndarray:
        """Rays (N, 2) of what is seen at (N, 2); NaN where the lens shows none there."""
        rays = np.array(seen, dtype=np.float64)
        with np.errstate(all="ignore"):  # where there is no ray, Newton's method runs off
            for _ in range(MAX_STEPS):
                error = self.distort(rays) - seen
                if not (np.abs(error) > CLOSE).any():
                    break
                dx = (self.distort(rays + (STEP, 0)) - seen - error) / STEP
                dy = (self.distort(rays + (0, STEP)) - seen - error) / STEP
                determinant = dx[:, 0] * dy[:, 1] - dx[:, 1] * dy[:, 0]
                rays[:, 0] -= (dy[:, 1] * error[:, 0] - dy[:, 0] * error[:, 1]) / determinant
                rays[:, 1] -= (dx[:, 0] * error[:, 1] - dx[:, 1] * error[:, 0]) / determinant
            right = (np.abs(self.distort(rays) - seen) < 1e3 * CLOSE).all(1) & (np.hypot(*rays.T) <= self.fold)
        rays[~right] = np.nan
        return rays


def _brown(x: np.ndarray, y: np.ndarray, k: np.ndarray, modified: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Radial polynomial, or quotient of two, with the tangential terms of the undistorted ray; ``modified``: of the
    radially distorted one. librealsense projects with the latter in its "inverse" model, too."""
    r2 = x * x + y * y
    radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    u, v = x * radial, y * radial
    if modified:
        x, y = u, v
    return u + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x), v + 2 * k[3] * x * y + k[2] * (r2 + 2 * y * y)


def _equidistant(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fisheye: the angle to the optical axis becomes the distance from the image's centre."""
    r = np.maximum(np.hypot(x, y), 1e-12)
    angle = np.arctan(r)
    a2 = angle * angle
    scale = angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3])))) / r
    return x * scale, y * scale


Forward = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
MODELS: dict[str, tuple[Forward, int]] = {
    **dict.fromkeys(("plumb_bob", "rational_polynomial", "brown_conrady"), (_brown, 8)),
    **dict.fromkeys(("modified_brown_conrady", "inverse_brown_conrady"), (partial(_brown, modified=True), 5)),
    **dict.fromkeys(("equidistant", "kannala_brandt4"), (_equidistant, 4)),
}
"""Where rays x and y (N,) are seen, given 8 coefficients, 0 where there are fewer; and how many the model has."""
