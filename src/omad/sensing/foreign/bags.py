"""Recordings: ROS 2 (MCAP, .db3) and ROS 1 bags, RealSense's .bag among them, read by the library rosbags."""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import readable

from ..camera_files import CameraFile
from .cameras import camera_from
from .images import depth_from, image_from

SUFFIXES = (".mcap", ".db3", ".bag")
IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
WITHIN = 0.05
"""Seconds by which a mask or a colour image may be older or younger than the depth image that it is for."""
NANOSECONDS = 1e-9


@dataclass(frozen=True)
class Topics:
    """Names of topics; those left out are looked for by the kind of their messages."""

    depth_topic: str | None = None
    """Image or CompressedImage."""
    info_topic: str | None = None
    """CameraInfo of the depth camera."""
    color_topic: str | None = None
    """Image that lies on the depth image."""
    mask_topic: str | None = None
    """Image, not zero where the object is."""


@dataclass(frozen=True)
class RecordedFrame:
    """One depth image of a recording."""

    name: str
    """Its time stamp or number."""
    time: float
    """Seconds."""
    depth: np.ndarray
    """(H, W) metres."""
    camera: CameraFile | None
    """Its camera, where that was told."""
    color: np.ndarray | None = None
    """(H, W, 3) uint8."""
    mask: np.ndarray | None = None
    """(H, W), not zero where the object is."""


def is_bag(path: Path) -> bool:
    """Whether a path is a recording: a file by its extension, or a ROS 2 bag's folder with ``metadata.yaml``."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix.lower() in SUFFIXES


def read_bag(path: Path, topics: Topics) -> Iterator[RecordedFrame]:
    """Depth images in the order of the recording, each with the last camera, colours and mask before it. Raises
    InputError for what cannot be read, and where the topics are not there."""
    try:
        highlevel, typesys = import_module("rosbags.highlevel"), import_module("rosbags.typesys")
    except ImportError as error:
        raise InputError(
            f"{path}: recordings need rosbags, which is not installed; pip install 'omad[bags]'"
        ) from error
    if not path.exists():
        raise InputError(f"{path}: no such recording; give an .mcap, .db3 or .bag file, or a ROS 2 bag's folder")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    with readable(path, "a recording"), highlevel.AnyReader([path], default_typestore=store) as reader:
        yield from _frames(reader, _chosen(reader, topics, path))


@dataclass(frozen=True)
class _Chosen:
    depth: Any
    info: Any
    color: Any
    mask: Any

    def all(self) -> list[Any]:
        return [each for each in (self.depth, self.info, self.color, self.mask) if each is not None]


def _chosen(reader: Any, topics: Topics, path: Path) -> _Chosen:
    images = [c for c in reader.connections if c.msgtype in (IMAGE, COMPRESSED)]

    def named(name: str | None) -> Any:
        if name is None:
            return None
        found = [c for c in reader.connections if c.topic == name]
        if not found:
            listed = ", ".join(sorted({c.topic for c in reader.connections}))
            raise InputError(f"{path}: no topic {name}; there are {listed}")
        return found[0]

    depth = named(topics.depth_topic)
    if depth is None:
        likely = [c for c in images if "depth" in c.topic.lower()] or images[:1]
        if not likely:
            listed = ", ".join(sorted({c.topic for c in reader.connections})) or "none"
            raise InputError(f"{path}: no images of depth in it; topics are {listed}; name one with --depth-topic")
        # raw depth keeps its pixels: what is aligned or registered to colours has been warped
        depth = min(likely, key=lambda c: ("aligned" in c.topic or "registered" in c.topic, c.topic))
    infos = [c for c in reader.connections if c.msgtype == INFO]
    info = named(topics.info_topic) or max(infos, key=lambda c: _common(c.topic, depth.topic), default=None)
    return _Chosen(depth, info, named(topics.color_topic), named(topics.mask_topic))


def _common(one: str, other: str) -> int:
    """Length of what two topics begin with."""
    return next((i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))


def _frames(reader: Any, chosen: _Chosen) -> Iterator[RecordedFrame]:
    camera: CameraFile | None = None
    beside: dict[str, tuple[float, np.ndarray]] = {}
    for connection, stamp, raw in reader.messages(connections=chosen.all()):
        message, time = reader.deserialize(raw, connection.msgtype), stamp * NANOSECONDS
        if connection.topic == chosen.depth.topic:
            recent = {name: image for name, (when, image) in beside.items() if time - when <= WITHIN}
            own = recent.get("color"), recent.get("mask")
            yield RecordedFrame(str(stamp), time, depth_from(message).depth, camera, *own)
        elif chosen.info is not None and connection.topic == chosen.info.topic:
            camera = camera_from(message)
        else:
            name = "color" if chosen.color is not None and connection.topic == chosen.color.topic else "mask"
            beside[name] = time, image_from(message)
