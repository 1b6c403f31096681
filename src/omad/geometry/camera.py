"""The camera: OpenCV axes (x right, y down, z forward), pixel centres at integers, a pinhole with or without a lens."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from omad.common.errors import InputError

from .lens import Distortion
from .rigid import box

NEAREST = 1e-6
"""Metres. Points nearer than this, and those behind the camera, are projected as if they were so far."""
WIDEST = 20.0
"""Focal lengths that an image is wide at most: a pinhole then sees 169 degrees, and a fisheye lens needs not 4."""
OFF_CENTRE = 0.12
"""Of the image's side, by how much a principal point may be off its middle; of cameras it is by a few per cent, but an
image may have been cropped."""
ALIKE, ANOTHER_SIZE = 0.05, 0.25
"""Of the logarithms of principal points in halves of the image's sides: how far they differ at most in intrinsics that
were only scaled, and from where on these are another image's."""
OBLONG = 0.1
"""Share by which fx and fy of sensors with square pixels differ at most."""


@dataclass(frozen=True)
class Camera:
    """Image size and pinhole intrinsics in pixels, and the lens where the image was not undistorted."""

    width: int
    """Pixels."""
    height: int
    """Pixels."""
    fx: float
    """Pixels."""
    fy: float
    """Pixels."""
    cx: float
    """Pixels, from the middle of the first column."""
    cy: float
    """Pixels, from the middle of the first row."""
    distortion: Distortion | None = None
    """The lens; None where the image was undistorted."""

    @property
    def K(self) -> np.ndarray:
        """(3, 3) intrinsic matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @classmethod
    def from_K(cls, K: np.ndarray, width: int, height: int, distortion: Distortion | None = None) -> Self:
        """Of an intrinsic matrix (3, 3). Raises InputError for one in shares of the image's size."""
        K = np.asarray(K)
        if min(K[0, 0] / width, K[1, 1] / height) * WIDEST < 1:
            shares = f"intrinsics: fx {K[0, 0]:g} and fy {K[1, 1]:g} are no pixels of a {width}x{height} image"
            raise InputError(f"{shares}; of shares of its size take fx and cx times its width, fy and cy its height")
        return cls(width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), distortion)

    @classmethod
    def around(cls, rays: np.ndarray, across: int, finest: float = np.inf) -> Self:
        """A pinhole that sees all ``rays`` (N, 2), x / z and y / z: ``across`` pixels along the longer side of its
        image, or less, where its focal length would be more than ``finest`` pixels."""
        low, high = box(rays)
        f = float(min(across / max(float((high - low).max()), 1e-6), finest))
        width, height = (np.ceil((high - low) * f).astype(int) + 1).tolist()
        return cls(width, height, f, f, float(-low[0] * f), float(-low[1] * f))

    @property
    def pinhole(self) -> Self:
        """The camera without its lens."""
        return replace(self, distortion=None)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels (N, 2) column and row, of points (N, 3) in the camera frame; NaN where the lens shows none of them."""
        seen = points[:, :2] / np.maximum(points[:, 2:], NEAREST)
        if self.distortion is not None:
            beyond = np.hypot(*seen.T) > self.distortion.fold
            seen = self.distortion.distort(seen)
            seen[beyond] = np.nan
        return seen * (self.fx, self.fy) + (self.cx, self.cy)

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Rays (N, 2), x / z and y / z, of pixels (N, 2) column and row; NaN where the lens shows none."""
        seen = np.empty((len(pixels), 2))
        for axis, (focal, centre) in enumerate(((self.fx, self.cx), (self.fy, self.cy))):  # by columns, which is quick
            np.subtract(pixels[:, axis], centre, out=seen[:, axis])
            seen[:, axis] /= focal
        return seen if self.distortion is None else self.distortion.undistort(seen)

    def backproject(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Points (N, 3) that pixels (N, 2) column and row show at ``depth`` (N,); NaN where the lens shows none."""
        rays, points = self.rays(pixels), np.empty((len(pixels), 3))
        points[:, 2] = depth
        for axis in range(2):
            np.multiply(rays[:, axis], depth, out=points[:, axis])
        return points

    def rectified(self, image: np.ndarray) -> np.ndarray:
        """The image (H, W) as ``pinhole`` would see it: each pixel takes the nearest one, outside is 0."""
        pixels = np.indices(image.shape)[::-1].reshape(2, -1).T
        place = self.project(self.pinhole.backproject(pixels, np.ones(len(pixels))))
        column, row = np.clip(np.nan_to_num(np.rint(place), nan=-1), -1, image.shape[::-1]).astype(int).T
        return np.pad(image, 1)[row + 1, column + 1].reshape(image.shape)

    def zoomed(self, factor: float, left: float = 0.0, top: float = 0.0, size: tuple[int, int] | None = None) -> Self:
        """The camera whose image is this one's, cut at the pixel place (``left``, ``top``) and scaled by ``factor``;
        ``size`` is its width and height, by default the whole image's."""
        width, height = size or (round(self.width * factor), round(self.height * factor))
        centre = (self.cx - left) * factor, (self.cy - top) * factor
        return type(self)(width, height, self.fx * factor, self.fy * factor, *centre, self.distortion)


STANDARD_CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
"""Camera of the standard views; its principal point is the image centre."""


def times_too_large(camera: Camera) -> float | None:
    """By how much the intrinsics are those of a larger image, or of a smaller one, as their principal point says; None
    where it says nothing of the kind: a camera's is about in the middle, and a crop's is off it otherwise."""
    across, down = (2 * camera.cx + 1) / camera.width, (2 * camera.cy + 1) / camera.height
    if min(across, down) <= 0 or abs(np.log(across / down)) > ALIKE or abs(np.log(across)) < ANOTHER_SIZE:
        return None
    return float(np.sqrt(across * down))


def intrinsics_doubts(camera: Camera) -> Iterator[str]:
    """Intrinsics of another image are the commonest mistake that nothing else shows."""
    sides = ((camera.cx, camera.width), (camera.cy, camera.height))
    off = max(abs(centre / max(side - 1, 1) - 0.5) for centre, side in sides)
    if off > OFF_CENTRE and min(camera.width, camera.height) > 1:
        middle, asked = (camera.width / 2, camera.height / 2), "are the intrinsics those of this image?"
        if np.allclose((camera.fx, camera.fy), middle, rtol=0.1):
            asked = "are they fx, fy, cx, cy, in this order?"
        elif np.allclose((camera.cy, camera.cx), middle, rtol=0.1):
            asked = "is the image transposed?"
        image = f"{camera.width}x{camera.height} image: {asked}"
        yield f"principal point ({camera.cx:.0f}, {camera.cy:.0f}) is far from the middle of the {image}"
    elif abs(np.log(camera.fx / camera.fy)) > OBLONG:
        asked = "right only where the image was stretched; are they fx, fy, cx, cy, in this order?"
        yield f"fx is {camera.fx:g} and fy {camera.fy:g}: {asked}"
