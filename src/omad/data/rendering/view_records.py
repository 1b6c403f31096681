"""What the JSON files of a folder of views hold, the user's own among them, and what of it cannot be."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omad.common.decode import Shape, Within
from omad.common.limits import limits
from omad.geometry.camera import Camera
from omad.geometry.rigid import is_rotation

from .depth_noise import NoiseLevel
from .rasteriser import NOTHING
from .standard_views import ObjectTruth

FORMAT = "omad-views-1"
UNIT = 1e-3
"""By which the length of an axis may differ from one."""
FARTHEST = 100.0
"""Metres: nothing is so far or so large."""
MOST_TURNS = 8 * np.pi
"""Radians of a limit; what is more is given in degrees."""
SLACK = 0.1
"""Radians or metres."""
FARTHEST_FROM_ITS_PIXELS = 1.5
"""Diagonals of the object, of its base."""
_PerJoint = Annotated[np.ndarray, Shape(None, 3)]


@dataclass(frozen=True)
class DatasetRecord:
    """dataset.json."""

    format: str
    category: str
    camera: Camera
    depth_scale: Annotated[float, Within(1e-9, 1e3)]
    objects: tuple[str, ...]
    views: Annotated[int, Within(0, 10_000_000)]
    seed: int = 0
    noise: NoiseLevel | None = None
    finished: bool = True
    clutter: bool = False

    def __post_init__(self) -> None:
        _check_camera(self.camera)
        if not self.objects:
            raise ValueError("objects: is empty; give at least one")
        if len(set(self.objects)) < len(self.objects):
            raise ValueError("objects: names one twice; give each a folder of its own")


@dataclass(frozen=True)
class ObjectRecord:
    """object.json."""

    axes: _PerJoint
    pivots: _PerJoint
    limits: Annotated[np.ndarray, Shape(None, 2)]
    part_boxes: Annotated[np.ndarray, Shape(None, 2, 3)]
    of_other_hand: bool = False
    name: str | None = None

    def __post_init__(self) -> None:
        if not (np.abs(np.linalg.norm(self.axes, axis=-1) - 1) < UNIT).all():
            raise ValueError("axes: are no unit vectors; give directions of length one")
        for key, ranges in (("limits", self.limits), ("part_boxes", self.part_boxes)):
            if not (ranges[:, 0] <= ranges[:, 1]).all():
                raise ValueError(f"{key}: are the wrong way round; give the least first")
        if (np.abs(self.limits) > MOST_TURNS).any():
            raise ValueError("limits: are of many turns; give radians, or metres of what slides")
        if (np.abs(self.part_boxes) > FARTHEST).any():
            raise ValueError("part_boxes: are larger than any object; give metres")


@dataclass(frozen=True)
class ViewRecord:
    """Where the object of one view is, and its camera where that is its own."""

    states: Annotated[np.ndarray, Shape(None)]
    T_camera_base: Annotated[np.ndarray, Shape(4, 4)]
    seed: tuple[int, ...] | None = None
    """None: that of its place in the folder."""
    camera: Camera | None = None

    def __post_init__(self) -> None:
        if self.camera is not None:
            _check_camera(self.camera)
        if not is_rotation(self.T_camera_base[:3, :3]):
            raise ValueError("T_camera_base: its 3x3 part is no rotation; give that of the base before the camera")
        if not np.array_equal(self.T_camera_base[3], (0, 0, 0, 1)):
            raise ValueError("T_camera_base: its last row is not 0, 0, 0, 1; give that of the base before the camera")
        if (np.abs(self.T_camera_base[:3, 3]) > FARTHEST).any():
            raise ValueError("T_camera_base: is farther away than any object; give metres")


def _check_camera(camera: Camera) -> None:
    """Raises ValueError for a camera that takes no images."""
    for name in ("width", "height"):
        if not 1 <= getattr(camera, name) <= limits().image_side:
            raise ValueError(f"camera.{name}: is {getattr(camera, name)}; give pixels")
    if not (min(camera.fx, camera.fy) > 0 and max(map(abs, (camera.fx, camera.fy, camera.cx, camera.cy))) < 1e7):
        raise ValueError("camera: fx, fy, cx or cy is none of a camera; give pixels")


def check_truth(view: ViewRecord, truth: ObjectTruth, camera: Camera, depth: np.ndarray, labels: np.ndarray) -> None:
    """Raises ValueError where a view's truth cannot be that of its images: of the ``camera``'s depth (H, W) metres, 0
    where nothing is measured, and labels (H, W), 255 where the object is not."""
    parts, shown = len(truth.part_boxes), labels != NOTHING
    if not shown.any():
        raise ValueError("labels: no pixel is one of the object's; label them, or leave the view out")
    if (highest := int(labels[shown].max())) >= parts:
        raise ValueError(f"labels: {highest} is no part; give 0 to {parts - 1}, and {NOTHING} where the object is not")
    low, high = truth.limits.T
    if (np.maximum(low - view.states, view.states - high) > high - low + SLACK).any():
        raise ValueError("states: are far beyond the limits; give radians, or metres of what slides")
    measured = shown & (depth > 0)
    if measured.any() and (nearest := depth[measured].min()) > FARTHEST:
        raise ValueError(f"depth: the object is {nearest:.0f} m away; depth_scale is in metres per stored integer")
    rows, columns = np.nonzero(measured & (depth < FARTHEST))
    if len(rows):
        z = depth[rows, columns]
        seen = np.median([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], axis=1)
        apart = float(np.linalg.norm(view.T_camera_base[:3, 3] - seen))
        if apart > FARTHEST_FROM_ITS_PIXELS * truth.diagonal:
            told = f"puts the object {apart:.2f} m from where its pixels are"
            cure = "give that of the base before the camera, in metres, as depth_scale tells of the pixels"
            raise ValueError(f"T_camera_base: {told}; {cure}")
