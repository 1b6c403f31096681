"""A colour image and a mask drawn in it, looked up for raw depth: two cameras side by side, with lenses of their own.
Depth is never warped: each of its points is projected into the colour image, and asks there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from omad.common.arrays import numbers
from omad.common.errors import InputError
from omad.common.limits import check_limit
from omad.geometry.camera import Camera
from omad.geometry.rigid import carry

from .camera_files import CameraFile
from .observation import region_of

CELL = 2.0
"""Cells of the occlusion check are so many depth pixels wide: the nearer surface leaves none of them empty."""
BEHIND = 0.03
"""A point that is farther than another in its cell by this share of the distance is hidden from the colour camera."""


@dataclass(frozen=True)
class ColourCamera:
    """The colour camera as the depth camera sees it."""

    camera: CameraFile
    T_color_depth: np.ndarray
    """(4, 4) takes points from the depth camera's frame to the colour camera's."""

    def depth_mask(
        self, depth: np.ndarray, camera: Camera, mask: np.ndarray | None, box: Sequence[float] | None
    ) -> np.ndarray:
        """(H, W) bool, the pixels of ``depth`` (H, W) metres whose points lie inside the colour image's ``mask``
        and ``box`` and are seen by the colour camera. Raises InputError where the mask is of another size, and for a
        box that no image holds."""
        chosen = (depth > 0) & np.isfinite(depth)
        points = camera.backproject(np.argwhere(chosen)[:, ::-1], depth[chosen])
        chosen[chosen] = self._inside(points, self._region(mask, box), CELL / camera.fx)
        return chosen

    def depth_box(self, depth: np.ndarray, camera: Camera, box: Sequence[float]) -> list[float]:
        """x1, y1, x2, y2, half-open, around what of ``depth`` lies inside the colour image's ``box``, as
        ``depth_mask`` has it. Raises InputError where nothing does."""
        inside = np.argwhere(self.depth_mask(depth, camera, None, box))
        if not len(inside):
            raise InputError("box: no depth was measured in it; it is one of the colour image")
        (top, left), (bottom, right) = inside.min(0).tolist(), inside.max(0).tolist()
        return [left, top, right + 1, bottom + 1]

    def seen_from_depth(self, depth: np.ndarray, camera: Camera, color: np.ndarray) -> np.ndarray:
        """(H, W, 3) of ``depth``'s pixels what the colour image shows where their points lie; black where it shows none
        of them, or there is no depth. Raises InputError where the image is of another size than its intrinsics."""
        height, width = color.shape[:2]
        if self.camera.size not in (None, (width, height)):
            told = "x".join(map(str, self.camera.size)) + "; give those of the colour image"
            raise InputError(f"--color is {width}x{height}, but --color-intrinsics are for {told}")
        measured = (depth > 0) & np.isfinite(depth)
        points = carry(self.T_color_depth, camera.backproject(np.argwhere(measured)[:, ::-1], depth[measured]))
        places = Camera.from_K(self.camera.K, width, height, self.camera.distortion).project(points)
        column, row = np.clip(np.nan_to_num(np.rint(places), nan=-1), -1, (width, height)).astype(int).T
        shown = np.zeros((*depth.shape, 3), color.dtype)
        colours = color if color.ndim == 3 else np.repeat(color[..., None], 3, 2)
        shown[measured] = np.pad(colours[..., :3], ((1, 1), (1, 1), (0, 0)))[row + 1, column + 1]
        return shown

    def _region(self, mask: np.ndarray | None, box: Sequence[float] | None) -> np.ndarray:
        """(H, W) bool of the colour image."""
        if mask is not None:
            height, width = mask.shape
            if self.camera.size not in (None, (width, height)):
                told = "x".join(map(str, self.camera.size)) + "; give those of the mask's image"
                raise InputError(f"--mask is {width}x{height}, but --color-intrinsics are for {told}")
        elif self.camera.size is not None:
            width, height = self.camera.size
        else:  # no image to end at: the box itself does
            ends = numbers((0, 0, 1, 1) if box is None else box, 4, what="box: x1, y1, x2, y2 in pixels")[2:]
            width, height = (int(max(end, 1)) + 1 for end in ends)
            check_limit("image_pixels", width * height, "box: the image that it lies in")
        return region_of((height, width), mask, box)

    def _inside(self, points: np.ndarray, region: np.ndarray, spacing: float) -> np.ndarray:
        """(N,) bool of points (N, 3) in the depth camera's frame; ``spacing`` is the width of a cell at 1 m."""
        seen = carry(self.T_color_depth, points)
        height, width = region.shape
        pixels = Camera.from_K(self.camera.K, width, height, self.camera.distortion).project(seen)
        result = np.isfinite(seen).all(1) & (seen[:, 2] > 0)
        result &= ((pixels >= -0.5) & (pixels < (width - 0.5, height - 0.5))).all(1)
        pixels, z = pixels[result], seen[result, 2]
        size = max(spacing * self.camera.K[0, 0], 1.0)
        across = int(width / size) + 1
        column, row = np.rint(pixels).astype(int).T
        cell = (row / size).astype(int) * across + (column / size).astype(int)
        nearest = np.full(int(cell.max(initial=0)) + 1, np.inf)
        np.minimum.at(nearest, cell, z)
        result[result] = region[row, column] & (z <= nearest[cell] * (1 + BEHIND))
        return result
