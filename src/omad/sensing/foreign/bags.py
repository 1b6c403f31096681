"""Recordings: ROS 2 (MCAP, .db3) and ROS 1 bags, RealSense's .bag among them, read by the library rosbags."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import as_path, readable

from ..camera_files import CameraFile
from .cameras import camera_from
from .images import depth_from, image_from

SUFFIXES = (".mcap", ".db3", ".bag")
IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
RECTIFIED = "image_rect"
"""In the name of a topic of images that have no lens any more."""
INSIDE = ("info", "camera_info")
"""What a camera's topic has after that of its images."""
WITHIN = 0.05
"""Seconds by which a mask or a colour image may be older or younger than the depth image that it is for."""
LATE = 2.0
"""Seconds by which it may be recorded later: masks are worked out."""
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


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """One depth image of a recording."""

    name: str
    """Its time stamp or number."""
    time: float
    """Seconds."""
    depth: np.ndarray
    """(H, W) metres; empty where there is a ``fault``."""
    camera: CameraFile | None
    """Its camera, where that was told."""
    color: np.ndarray | None = None
    """(H, W, 3) uint8."""
    mask: np.ndarray | None = None
    """(H, W), not zero where the object is."""
    fault: InputError | None = None
    """Why its images cannot be read: those of others may be."""
    in_millimetres: bool = False
    """Whether depth was stored as integers, which were taken for those."""


def is_bag(path: Path) -> bool:
    """Whether a path is a recording: a file by its extension, or a ROS 2 bag's folder with ``metadata.yaml``."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix.lower() in SUFFIXES


def read_bag(path: str | Path, topics: Topics = Topics(), with_cameras: bool = True) -> Iterator[RecordedFrame]:
    """Depth images in the order of the recording, each with its camera, and with the colours and the mask that were
    taken at the same moment by the stamps in their headers; not ``with_cameras``, what is recorded of these is not
    asked for. Raises InputError for a recording that cannot be read, and where the topics are not there."""
    path = as_path(path, "a recording")
    try:
        highlevel, typesys = import_module("rosbags.highlevel"), import_module("rosbags.typesys")
    except ImportError as error:
        raise InputError(
            f"{path}: recordings need rosbags, which is not installed; pip install 'omad[bags]'"
        ) from error
    if not path.exists():
        raise InputError(f"{path}: no such recording; give an .mcap, .db3 or .bag file, or a ROS 2 bag's folder")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    cure = "export it again, or mend it (mcap recover, ros2 bag reindex)"
    with readable(path, "a recording", cure), highlevel.AnyReader([path], default_typestore=store) as reader:
        chosen = _chosen(reader, topics, path)
        frame = None
        for frame in _frames(reader, chosen if with_cameras else replace(chosen, info=[])):
            yield frame
        if frame is None:
            raise InputError(f"{path}: topic {chosen.depth[0].topic} has no images; name another with --depth-topic")


@dataclass(frozen=True)
class _Chosen:
    """Connections of each topic: of one that was published anew there are several."""

    depth: list[Any]
    info: list[Any]
    color: list[Any]
    mask: list[Any]

    def all(self) -> list[Any]:
        return [*self.depth, *self.info, *self.color, *self.mask]


def _chosen(reader: Any, topics: Topics, path: Path) -> _Chosen:
    listed = sorted({c.topic for c in reader.connections})

    def of(topic: str | None, *kinds: str) -> list[Any]:
        if topic is not None and topic not in listed:
            raise InputError(f"{path}: no topic {topic}; there are {', '.join(listed)}")
        found = [c for c in reader.connections if c.topic == topic]
        if odd := next((c.msgtype for c in found if c.msgtype not in kinds), None):
            raise InputError(f"{path}: topic {topic} holds {odd}; name one of {' or '.join(kinds)}")
        return found

    depth = topics.depth_topic
    if depth is None:
        images = [c.topic for c in reader.connections if c.msgtype in (IMAGE, COMPRESSED)]
        likely = [topic for topic in images if "depth" in topic.lower()] or images[:1]
        if not likely:
            there = ", ".join(listed) or "none"
            raise InputError(f"{path}: no images of depth in it; topics are {there}; name one with --depth-topic")
        # raw depth keeps its pixels: what is aligned or registered to colours has been warped
        depth = min(likely, key=lambda topic: ("aligned" in topic or "registered" in topic, topic))
    infos = {c.topic for c in reader.connections if c.msgtype == INFO}
    info = topics.info_topic or _camera_beside(depth, infos)
    of_depth, of_color, of_mask = (
        of(topic, IMAGE, COMPRESSED) for topic in (depth, topics.color_topic, topics.mask_topic)
    )
    return _Chosen(of_depth, of(info, INFO), of_color, of_mask)


def _camera_beside(image: str, infos: set[str]) -> str | None:
    """Of ``infos`` the topic in the namespace of an ``image``'s; a camera of another one is not the image's."""
    words, found = image.split("/"), {}
    for info in infos:
        own = info.split("/")
        shared = next((i for i, (a, b) in enumerate(zip(own, words, strict=False)) if a != b), len(own))
        if all(word in INSIDE for word in own[shared:]):
            found[info] = shared
    return max(sorted(found), key=found.__getitem__, default=None)


@dataclass(frozen=True)
class _Image:
    """A message as it was recorded."""

    message: Any
    recorded: int
    """Nanoseconds."""

    @property
    def stamp(self) -> int:
        """Nanoseconds: when it was taken, as its header says; some leave that out. A recorder writes when it gets to
        it: late, and several at once."""
        told = self.message.header.stamp
        return told.sec * 10**9 + told.nanosec or self.recorded

    @property
    def taken(self) -> float:
        """Seconds, of that."""
        return self.stamp / 10**9


def _frames(reader: Any, chosen: _Chosen) -> Iterator[RecordedFrame]:
    # the camera may be told after the first image
    infos = reader.messages(connections=chosen.info) if chosen.info else ()
    camera = next((_camera(reader.deserialize(raw, told.msgtype), told.topic) for told, _, raw in infos), None)
    depth, info, color = ({c.topic for c in found} for found in (chosen.depth, chosen.info, chosen.color))
    waiting: deque[tuple[_Image, CameraFile | None]] = deque()
    beside: dict[str, deque[_Image]] = {kind: deque() for kind in ("color", "mask") if getattr(chosen, kind)}

    def settled(frame: _Image, now: int) -> bool:
        """Whether no image that is yet to come may be nearer to it."""
        late = (now - frame.recorded) * NANOSECONDS > LATE
        return late or all(images and images[-1].taken >= frame.taken for images in beside.values())

    def first() -> RecordedFrame:
        frame, own = waiting.popleft()
        name, time = str(frame.stamp), frame.taken
        try:
            with_it: dict[str, Any] = {kind: _nearest(images, frame.taken) for kind, images in beside.items()}
            if chosen.mask and with_it["mask"] is None:  # without one, another object might be followed
                raise InputError(f"no mask of {chosen.mask[0].topic} was taken within {WITHIN:g} s of it")
            seen = depth_from(frame.message)
            return RecordedFrame(name, time, seen.depth, own, **with_it, in_millimetres=seen.in_millimetres)
        except InputError as error:
            return RecordedFrame(name, time, np.zeros((0, 0)), own, fault=error)

    for connection, recorded, raw in reader.messages(connections=chosen.all()):
        message = reader.deserialize(raw, connection.msgtype)
        if connection.topic in info:
            camera = _camera(message, connection.topic)
        elif connection.topic in depth:
            own = camera and camera.without_lens() if RECTIFIED in connection.topic else camera
            waiting.append((_Image(message, recorded), own))
        else:
            images = beside["color" if connection.topic in color else "mask"]
            images.append(_Image(message, recorded))
            while not waiting and (recorded - images[0].recorded) * NANOSECONDS > LATE:
                images.popleft()
        while waiting and settled(waiting[0][0], recorded):
            yield first()
    while waiting:
        yield first()


def _camera(message: Any, topic: str) -> CameraFile | None:
    try:
        return camera_from(message)
    except InputError as error:
        raise InputError(f"{topic}: {error}; or give --intrinsics in its place") from error


def _nearest(images: deque[_Image], taken: float) -> np.ndarray | None:
    """Of those taken at that time or nearly so; what is older is forgotten."""
    while images and images[0].taken < taken - WITHIN:
        images.popleft()
    near = min(images, key=lambda image: abs(image.taken - taken), default=None)
    return None if near is None or near.taken > taken + WITHIN else image_from(near.message)
