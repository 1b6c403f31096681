"""An estimated surface held against a depth image, pixel by pixel."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from omad.data.rendering.rasteriser import render_parts
from omad.geometry.camera import Camera
from omad.geometry.mesh import Mesh
from omad.geometry.rigid import box
from omad.sensing.observation import Observation

ACROSS = 160
"""Pixels that are compared along the longer side of the picture around the object; fewer where the image has fewer."""
MARGIN = 0.02
"""Of the object's size: depths that differ by less are the same."""
SIZED = 4000
"""Points that its size is taken of."""


@dataclass(frozen=True)
class Agreement:
    """What becomes of the pixels that show the object or should show it; shares that sum to one."""

    explained: float
    """The surface is where the object was seen."""
    in_front: float
    """The surface is nearer than what was seen: the camera looked through it."""
    behind: float
    """The surface is behind where the object was seen."""
    missing: float
    """The object was seen where there is no surface."""

    @classmethod
    def of(cls, parts: Sequence[Mesh], observation: Observation, across: int = ACROSS) -> "Agreement":
        """Parts (camera frame, metres) and what was seen of them, in a picture so many pixels ``across``."""
        if not (observation.points[:, 2] > 0).any():
            return NOWHERE
        return Overlay.of(parts, observation, across).agreement


NOWHERE = Agreement(0.0, 0.0, 0.0, 1.0)
"""Of an object that is nowhere, or was seen behind the camera."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """The picture that an ``Agreement`` is taken of."""

    camera: Camera
    """Of both images."""
    seen: np.ndarray
    """(H, W) metres that were measured, 0 where nothing was."""
    object: np.ndarray
    """(H, W) bool, where what was measured is the object."""
    rendered: np.ndarray
    """(H, W) metres of the surface, 0 where there is none."""
    same: float
    """Metres by which depths may differ."""

    @classmethod
    def of(cls, parts: Sequence[Mesh], observation: Observation, across: int = ACROSS) -> "Overlay":
        """Parts (camera frame, metres) and what was seen of them, a depth image or a cloud."""
        camera = _camera_around(parts, observation, across)
        rendered = render_parts(parts, camera).depth
        some = observation.points[:: -(-len(observation.points) // SIZED)]
        size = float(np.linalg.norm(np.ptp(np.percentile(some, [2, 98], axis=0), axis=0)))
        return cls(camera, *_seen(observation, camera), rendered, MARGIN * size)

    @cached_property
    def differences(self) -> dict[str, np.ndarray]:
        """(H, W) bool of each share of an ``Agreement``. What is hidden behind other things, and what lies where
        nothing was measured, is in none."""
        both, nearer = (self.seen > 0) & (self.rendered > 0), self.seen - self.rendered
        return {
            "explained": both & self.object & (np.abs(nearer) <= self.same),
            "in_front": both & (nearer > self.same),
            "behind": both & self.object & (nearer < -self.same),
            "missing": self.object & (self.rendered == 0),
        }

    @property
    def agreement(self) -> Agreement:
        """Of all pixels; all are missing where none shows or should show the object."""
        counts = {name: int(np.count_nonzero(where)) for name, where in self.differences.items()}
        total = sum(counts.values())
        return Agreement(**{name: count / total for name, count in counts.items()}) if total else NOWHERE


def _camera_around(parts: Sequence[Mesh], observation: Observation, across: int) -> Camera:
    """One that sees surface and cloud, with pixels no finer than those of the image."""
    before = map(_before, (observation.points, *(part.vertices for part in parts)))
    rays = np.concatenate([box(points[:, :2] / points[:, 2:]) for points in before if len(points)])
    if observation.camera is not None:
        return Camera.around(rays, across, observation.camera.fx)
    area = max(float(np.prod(np.ptp(rays, axis=0))), 1e-12)
    return Camera.around(rays, across, 0.5 * np.sqrt(len(observation.points) / area))


def _before(points: np.ndarray) -> np.ndarray:
    """Those before the camera, of points (N, 3)."""
    return points if (points[:, 2] > 0).all() else points[points[:, 2] > 0]


def _seen(observation: Observation, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """What ``camera`` would have measured (H, W), and whether it is the object."""
    depth, chosen, own = observation.depth, observation.mask, observation.camera
    if depth is None or chosen is None or own is None:
        points = _before(observation.points)
        column, row = np.rint(camera.project(points)).astype(int).T
        cloud = np.full((camera.height, camera.width), np.inf, np.float32)
        np.minimum.at(cloud, (row, column), points[:, 2])
        hit = np.isfinite(cloud)
        return np.where(hit, cloud, 0), hit
    pixels = np.indices((camera.height, camera.width))[::-1].reshape(2, -1).T
    column, row = np.rint(own.project(camera.backproject(pixels, np.ones(len(pixels))))).astype(int).T
    inside = (column >= 0) & (column < own.width) & (row >= 0) & (row < own.height)
    place = row.clip(0, own.height - 1), column.clip(0, own.width - 1)
    shape = camera.height, camera.width
    return np.where(inside, depth[place], 0).reshape(shape), (inside & chosen[place]).reshape(shape)
