"""Recordings as ROS drivers make them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from sequences import SequenceFrame

START = 1_700_000_000_000_000_000
DEPTH_INFO = "/camera/depth/camera_info"
PINHOLE = [600, 0, 319.5, 0, 600, 239.5, 0, 0, 1], [0] * 5, [0] * 12


def write_bag(
    path: Path,
    sequence: list[SequenceFrame],
    kind: str,
    late: int = 0,
    info: str = DEPTH_INFO,
    camera=PINHOLE,
    together: int = 1,
    masks: Sequence[int] | None = None,
) -> Path:
    """Depth, its camera (K, D, P) and a mask, as a ROS driver records them: the latter so many nanoseconds ``late``;
    so many depth images are written ``together``; only those of these numbers have ``masks``, where they are given.
    Half way the driver is started anew."""
    pytest.importorskip("rosbags", reason="recordings are an extra: pip install 'omad[bags]'")
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    first = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    types = store.types
    Time, Header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    sequence_number = {"seq": 0} if first else {}
    writer = Writer1(path) if first else Writer2(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
    with writer:
        kinds = {"/camera/depth/image_rect_raw": "Image", info: "CameraInfo", "/mask": "Image"}
        # ROS 1 keeps a connection of each publisher
        topics = {(name, anew): writer.add_connection(name, f"sensor_msgs/msg/{type}", typestore=store,
                                                      **({"callerid": f"/{anew}"} if first else {}))
                  for name, type in kinds.items() for anew in {False, first}}  # fmt: skip

        def send(topic: str, message, stamp: int) -> None:
            dump = store.serialize_ros1 if first else store.serialize_cdr
            connection = topics[topic, first and stamp > START + 150_000_000]
            writer.write(connection, stamp, dump(message, connection.msgtype))

        def image(array: np.ndarray, encoding: str, header):
            step = array.shape[1] * array.itemsize
            data = np.ascontiguousarray(array).view(np.uint8).ravel()
            return types["sensor_msgs/msg/Image"](header, *array.shape, encoding, 0, step, data)

        for index, frame in enumerate(sequence):
            stamp = START + index * 100_000_000
            header = Header(**sequence_number, stamp=Time(stamp // 10**9, stamp % 10**9), frame_id="camera")
            roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
            K, D, P = (np.array(values, float) for values in camera)
            values = header, 480, 640, "plumb_bob", D, K, np.eye(3).ravel(), P, 0, 0, roi
            send(info, types["sensor_msgs/msg/CameraInfo"](*values), stamp + late)
            if masks is None or index in masks:
                send("/mask", image((frame.depth > 0).astype(np.uint8) * 255, "mono8", header), stamp + late)
            stored = np.rint(frame.depth * 1000).astype(np.uint16)
            written = START + index // together * together * 100_000_000 + 1000
            send("/camera/depth/image_rect_raw", image(stored, "16UC1", header), written)
    return path
