"""Images and clouds: Open3D's ``Image``, ``RGBDImage`` and ``PointCloud``, librealsense's frames, ROS's ``Image``,
``CompressedImage`` and ``PointCloud2`` (1 and 2), anything with ``points`` or ``vertices``."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import read_image
from omad.common.limits import check_limit

from ..camera_files import CameraFile
from ..depth_files import in_metres
from .cameras import camera_from

ENCODINGS: dict[str, tuple[str, int]] = {
    "16UC1": ("u2", 1), "mono16": ("u2", 1), "32FC1": ("f4", 1), "64FC1": ("f8", 1), "8UC1": ("u1", 1),
    "mono8": ("u1", 1), "8UC3": ("u1", 3), "rgb8": ("u1", 3), "bgr8": ("u1", 3), "rgba8": ("u1", 4), "bgra8": ("u1", 4),
    "16SC1": ("i2", 1), "32SC1": ("i4", 1),
}  # fmt: skip
"""Of ROS images: kind of number, and how many a pixel has."""
FIELDS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""Kinds of number of a PointCloud2's fields, from 1 on."""
PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class DepthObject:
    """What a depth image of another package carries."""

    depth: Any
    """(H, W); metres, where the object tells its unit, else as it is stored."""
    camera: CameraFile | None = None
    color: Any = None
    """(H, W, 3), where it lies on the depth image."""
    in_millimetres: bool = False
    """Whether integers of a unit that nothing tells were taken for those."""


def depth_from(value: Any) -> DepthObject:
    """The depth image that an object is, with the camera and the colours that it brings along; anything else as it is.
    Raises InputError for an image that is none."""
    value = _legacy(value)
    if hasattr(value, "depth") and hasattr(value, "color"):  # Open3D's RGBDImage
        return DepthObject(image_from(value.depth), None, image_from(value.color))
    if hasattr(value, "get_data") and hasattr(value, "get_units"):  # librealsense's depth_frame
        camera = camera_from(value.get_profile().as_video_stream_profile().get_intrinsics())
        return DepthObject(in_metres(np.asanyarray(value.get_data()), float(value.get_units())), camera)
    image = image_from(value)
    if image is not value and isinstance(image, np.ndarray) and hasattr(value, "header") and image.dtype.kind == "u":
        return DepthObject(in_metres(image), in_millimetres=True)  # by ROS's convention (REP 118)
    if image is not value and isinstance(image, np.ndarray) and image.dtype.kind == "i":
        told = getattr(value, "encoding", None) or getattr(value, "format", "")
        raise InputError(f"depth: encoding {told!r} is one of labels; send 16UC1 or 32FC1")
    return DepthObject(image)


def image_from(value: Any) -> Any:
    """(H, W) or (H, W, channels) of an image object, colours as red, green, blue; anything else as it is."""
    value = _legacy(value)
    if hasattr(value, "encoding") and hasattr(value, "step"):
        return _ros_image(value)
    if (
        hasattr(value, "format")
        and isinstance(value.format, str)
        and hasattr(value, "data")
        and hasattr(value, "header")
    ):
        return _ros_compressed(value)
    if hasattr(value, "get_data"):  # a frame of librealsense
        image = np.asanyarray(value.get_data())
        return image[..., 2::-1] if ".bgr" in str(value.get_profile().format()) else image
    return value


def eight_bits(image: np.ndarray) -> np.ndarray:
    """Colours as uint8: floats up to 1 (resampling overshoots a little) or up to 255, and integers of 8 or 16 bits."""
    if image.dtype.kind == "f":
        image = np.nan_to_num(image)
        image = image * (255 if image.max(initial=0) <= 2 else 1)
    elif image.dtype == np.uint16 and image.max(initial=0) > 255:
        image = image >> 8
    return np.clip(image, 0, 255).astype(np.uint8)


def points_from(value: Any) -> Any:
    """(N, 3) of a cloud object, in its own unit; anything else as it is. Raises InputError for a cloud that is none."""
    value = _legacy(value)
    if hasattr(value, "point_step") and hasattr(value, "fields"):
        return _ros_cloud(value)
    if hasattr(value, "get_vertices") and hasattr(value, "get_texture_coordinates"):  # librealsense's points
        return np.asanyarray(value.get_vertices()).view(np.float32).reshape(-1, 3)
    for name in ("points", "vertices"):
        if not isinstance(value, np.ndarray) and hasattr(value, name):
            return np.asarray(getattr(value, name))
    return value


def _legacy(value: Any) -> Any:
    """Open3D's tensor classes as its plain ones."""
    return value.to_legacy() if hasattr(value, "to_legacy") else value


def _ros_image(message: Any) -> np.ndarray:
    if message.encoding not in ENCODINGS:
        raise InputError(
            f"image: encoding {message.encoding!r} is not known; convert it to one of {', '.join(ENCODINGS)}"
        )
    kind, channels = ENCODINGS[message.encoding]
    dtype = np.dtype(f"{'>' if message.is_bigendian else '<'}{kind}")
    height, width, step = int(message.height), int(message.width), int(message.step)
    row, stored = width * channels * dtype.itemsize, _bytes(message.data)
    if min(height, width) < 1 or step < row or len(stored) < step * height:
        raise InputError(
            f"image: {len(stored)} bytes are no {width}x{height} image of {message.encoding}; send it again"
        )
    check_limit("image_pixels", height * width, "the image")
    rows = np.frombuffer(stored, np.uint8, step * height).reshape(height, step)[:, :row]
    image = np.ascontiguousarray(rows).view(dtype).reshape(height, width, channels)
    if message.encoding.startswith("bgr"):
        image = image[..., [2, 1, 0, *range(3, channels)]]
    return image[..., 0] if channels == 1 else image


def _ros_compressed(message: Any) -> np.ndarray:
    """Depth is PNG behind a head of its own."""
    stored = _bytes(message.data)
    if "compressedDepth" in message.format:
        if (start := stored.find(PNG)) < 0 or message.format.startswith("32FC1"):
            raise InputError(f"image: {message.format!r} is not supported; send 16UC1 as PNG, or uncompressed images")
        stored = stored[start:]
    return read_image(stored, "image")


def _ros_cloud(message: Any) -> np.ndarray:
    places = {field.name: field for field in message.fields}
    order = ">" if message.is_bigendian else "<"
    count, step, stored = int(message.width) * int(message.height), int(message.point_step), _bytes(message.data)
    check_limit("cloud_points", count, "the cloud")
    row_step = int(message.row_step) or step * int(message.width)
    axes: list[Any] = [places[axis] for axis in "xyz" if axis in places]
    if len(axes) < 3 or not all(1 <= axis.datatype <= len(FIELDS) for axis in axes):
        raise InputError("points: the PointCloud2 has no fields x, y and z of numbers; send a cloud with them")
    if step < 1 or row_step < step * int(message.width) or len(stored) < row_step * int(message.height):
        raise InputError(f"points: {len(stored)} bytes are no cloud of {count} points; send it again")
    rows = np.frombuffer(stored, np.uint8, row_step * int(message.height)).reshape(int(message.height), row_step)
    table = np.ascontiguousarray(rows[:, : step * int(message.width)]).reshape(count, step)
    columns = []
    for axis in axes:
        dtype = np.dtype(f"{order}{FIELDS[axis.datatype - 1]}")
        if axis.offset + dtype.itemsize > step:
            raise InputError("points: a field of the PointCloud2 lies outside its points; send it again")
        columns.append(np.ascontiguousarray(table[:, axis.offset : axis.offset + dtype.itemsize]).view(dtype)[:, 0])
    return np.stack(columns, 1).astype(np.float64)


def _bytes(data: Any) -> bytes:
    return data.tobytes() if isinstance(data, np.ndarray) else bytes(data)
