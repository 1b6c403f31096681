"""Cameras: librealsense's ``intrinsics``, Open3D's ``PinholeCameraIntrinsic`` and ``PinholeCameraParameters``, ROS's
``CameraInfo`` (1 and 2), or a table with what these have."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from omad.geometry.camera import Camera

from ..camera_files import CameraFile, camera_of, read_camera

CARRIED = (
    "width",
    "height",
    "fx",
    "fy",
    "ppx",
    "ppy",
    "cx",
    "cy",
    "K",
    "k",
    "P",
    "p",
    "D",
    "d",
    "distortion_model",
    "model",
    "coeffs",
    "binning_x",
    "binning_y",
    "roi",
)
"""What cameras call it, but for Open3D's matrix."""


def camera_from(value: Any) -> CameraFile | None:
    """The camera that an object is, or a file or ``fx,fy,cx,cy`` names; None where it is numbers or none of these.
    Raises InputError for a camera that cannot be one."""
    if isinstance(value, CameraFile):
        return value
    if isinstance(value, Camera):
        return CameraFile(value.K, value.distortion, (value.width, value.height))
    if isinstance(value, str | Path):
        return read_camera(value)
    if isinstance(value, Mapping):
        return camera_of(dict(value), "intrinsics")
    if hasattr(inner := getattr(value, "intrinsic", value), "intrinsic_matrix"):
        K = np.asarray(inner.intrinsic_matrix)  # row by row, unlike in Open3D's files
        return camera_of({"K": K, "width": int(inner.width), "height": int(inner.height)}, "intrinsics")
    if hasattr(value, "fx") or (hasattr(value, "distortion_model") and (hasattr(value, "k") or hasattr(value, "K"))):
        told = {name: getattr(value, name) for name in CARRIED if hasattr(value, name)}
        return camera_of(told, type(value).__name__)
    return None
