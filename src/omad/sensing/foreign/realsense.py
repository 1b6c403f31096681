"""Live frames of a RealSense camera, through its maker's package pyrealsense2."""

import time
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np

from omad.common.errors import InputError, WorkError

from .bags import RecordedFrame
from .images import depth_from, image_from


def open_camera() -> Iterator[RecordedFrame]:
    """Depth frames of the first camera as they come, the newest first where they come faster than they are asked for;
    with colours where the camera has them, warped onto the depth image. Raises InputError where the package or a camera
    is missing, WorkError where it stops sending."""
    try:
        rs: Any = import_module("pyrealsense2")
    except ImportError as error:
        raise InputError("--camera realsense needs pyrealsense2; pip install 'omad[realsense]'") from error
    pipeline = rs.pipeline()
    try:
        pipeline.start()
    except RuntimeError as error:
        raise InputError(
            f"--camera realsense: cannot be opened ({error}); plug it in, or close what uses it"
        ) from error
    return _frames(rs, pipeline)


def _frames(rs: Any, pipeline: Any) -> Iterator[RecordedFrame]:
    onto_depth, began = rs.align(rs.stream.depth), time.monotonic()
    try:
        while True:
            try:
                frames = pipeline.wait_for_frames()
            except RuntimeError as error:
                if "end of file" in str(error).lower():  # a recording that is played back
                    return
                raise WorkError(
                    f"--camera realsense: sends no more frames ({error}); unplug it and plug it in"
                ) from error
            frames = onto_depth.process(frames) if frames.get_color_frame() else frames
            depth, color = frames.get_depth_frame(), frames.get_color_frame()
            if not depth:
                continue
            seen = depth_from(depth)
            colours = np.array(image_from(color)) if color else None  # a copy: the camera uses its memory again
            yield RecordedFrame(
                f"{depth.get_frame_number():06d}", time.monotonic() - began, seen.depth, seen.camera, colours
            )
    finally:
        pipeline.stop()
