"""Lens distortion: where a ray of the pinhole camera is seen, and back.

Rays and places are (x, y) = (X / Z, Y / Z): pixels without focal length and principal point. Every model says where
a ray is seen (forward, in closed form); the way back is Newton's method on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .camera import Camera
from .errors import InputError

MAX_STEPS = 20
CLOSE = 1e-9
"""Of a seen place to the one asked for: a millionth of a pixel."""
STEP = 1e-6
"""Of the difference quotient."""


@dataclass(frozen=True)
class Distortion:
    """A lens, by the names and coefficients that camera drivers use.

    ``plumb_bob`` (k1, k2, p1, p2[, k3]), ``rational_polynomial`` (k1, k2, p1, p2, k3, k4, k5, k6) and ``equidistant``
    (k1, k2, k3, k4) are those of ROS and OpenCV; ``brown_conrady``, ``modified_brown_conrady``,
    ``inverse_brown_conrady`` (k1, k2, p1, p2, k3) and ``kannala_brandt4`` (k1, k2, k3, k4) those of librealsense.
    Raises InputError for other models and for coefficients that are too many or no numbers.
    """

    model: str
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"distortion model {self.model!r}: is unknown; known ones are {', '.join(MODELS)}")
        given, size = np.asarray(self.coefficients, dtype=np.float64), MODELS[self.model].coefficients
        if given.ndim != 1 or not np.isfinite(given).all() or given[size:].any():
            raise InputError(f"distortion {self.model}: {self.coefficients}: give at most {size} finite numbers")

    def distort(self, rays: np.ndarray) -> np.ndarray:
        """Where rays (N, 2) are seen (N, 2)."""
        model = MODELS[self.model]
        padded = np.zeros(model.coefficients)
        given = np.asarray(self.coefficients, dtype=np.float64)[: model.coefficients]
        padded[: len(given)] = given
        return np.stack(model.forward(rays[:, 0], rays[:, 1], padded), 1)

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
            right = (np.abs(self.distort(rays) - seen) < 1e3 * CLOSE).all(1)
        rays[~right] = np.nan
        return rays


def project(points: np.ndarray, K: np.ndarray, distortion: Distortion | None) -> np.ndarray:
    """Pixels (N, 2) column and row, of points (N, 3) before the camera with this lens."""
    rays = points[:, :2] / points[:, 2:]
    seen = rays if distortion is None else distortion.distort(rays)
    return seen * (K[0, 0], K[1, 1]) + (K[0, 2], K[1, 2])


def pixel_rays(pixels: np.ndarray, camera: Camera, distortion: Distortion | None) -> np.ndarray:
    """Rays (N, 2) of pixels (N, 2) column and row; NaN where the lens shows none."""
    seen = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return seen if distortion is None else distortion.undistort(seen)


def rectified(image: np.ndarray, camera: Camera, distortion: Distortion) -> np.ndarray:
    """The image (H, W) as the camera without its lens would see it: each pixel takes the nearest one, outside is 0."""
    rows, columns = np.indices(image.shape)
    rays = pixel_rays(np.stack([columns.ravel(), rows.ravel()], 1), camera, None)
    place = distortion.distort(rays) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    column, row = np.clip(np.nan_to_num(np.rint(place), nan=-1), -1, max(image.shape)).astype(int).T
    inside = (column >= 0) & (column < image.shape[1]) & (row >= 0) & (row < image.shape[0])
    flat = np.zeros(image.size, dtype=image.dtype)
    flat[inside] = image[row[inside], column[inside]]
    return flat.reshape(image.shape)


Forward = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class _Model:
    forward: Forward
    coefficients: int


def _brown(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radial polynomial, or quotient of two, with the tangential terms of the undistorted ray."""
    r2 = x * x + y * y
    radial = _radial(r2, k) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    return (
        x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
        y * radial + 2 * k[3] * x * y + k[2] * (r2 + 2 * y * y),
    )


def _modified_brown(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As Brown's, but the tangential terms are those of the radially distorted ray. librealsense projects with it in
    its "inverse" model, too."""
    r2 = x * x + y * y
    x, y = x * _radial(r2, k), y * _radial(r2, k)
    return (
        x + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
        y + 2 * k[3] * x * y + k[2] * (r2 + 2 * y * y),
    )


def _radial(r2: np.ndarray, k: np.ndarray) -> np.ndarray:
    return 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))


def _equidistant(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fisheye: the angle to the optical axis becomes the distance from the image's centre."""
    r = np.maximum(np.hypot(x, y), 1e-12)
    angle = np.arctan(r)
    a2 = angle * angle
    scale = angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3])))) / r
    return x * scale, y * scale


MODELS = {
    "plumb_bob": _Model(_brown, 8),
    "rational_polynomial": _Model(_brown, 8),
    "brown_conrady": _Model(_brown, 8),
    "modified_brown_conrady": _Model(_modified_brown, 5),
    "inverse_brown_conrady": _Model(_modified_brown, 5),
    "equidistant": _Model(_equidistant, 4),
    "kannala_brandt4": _Model(_equidistant, 4),
}
