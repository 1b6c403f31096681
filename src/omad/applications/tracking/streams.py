"""Frames of folders, recordings and cameras, read alike."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from omad.common.errors import InputError, named
from omad.sensing.depth_files import MILLIMETRES
from omad.sensing.foreign.bags import RecordedFrame, Topics, read_bag
from omad.sensing.input_options import FrameOptions, InputOptions
from omad.sensing.observation import Observation
from omad.sensing.reader import INTRINSICS, Find, InputReader

from .frames import FrameFile

AHEAD = 60.0
"""Seconds without a frame after which it takes a second one to say that they have passed."""


@dataclass
class FrameReader:
    """Reads each frame as the options say; what they say of all frames is read with the first one."""

    options: InputOptions
    frame: FrameOptions
    find: Find
    """Cuts the object out where the options do not say where it is."""
    _reader: InputReader | None = field(init=False, default=None)
    _size: str = field(init=False, default="")

    def __call__(self, frame: FrameFile) -> Observation:
        """Raises InputError, also for a frame of another size than the ones before."""
        if self._reader is None:
            files = [frame.path] if frame.source is None else []
            self._reader = replace(InputReader.of(self.options, files, self.frame), find=self._cut_out)
        reader, source = self._reader, frame.source
        with named(frame.path):
            if source is None:
                return self._of_one_size(reader(frame.path))
            if isinstance(reader.mask, Path):
                raise InputError(f"--mask {reader.mask}: is a folder, but frames are no files; give --mask-topic")
            if isinstance(reader.color, Path):
                raise InputError(f"--color {reader.color}: is a folder, but frames are no files; give --color-topic")
            mask = reader.mask if source.mask is None else source.mask
            if mask is None:
                reader.check_mask_id()
            camera = reader.camera or source.camera
            if camera is None:
                raise InputError("its camera is not told; name its topic with --info-topic, or give --intrinsics")
            depth, scale = source.depth, reader.depth_scale
            if source.in_millimetres:  # what a camera file tells is of integers
                scale = (scale or reader.metres_per_integer(camera.depth_scale)) / MILLIMETRES
            depth = depth if scale is None else (depth * scale).astype(np.float32)
            color = source.color if reader.color is None else reader.color
            told_by = INTRINSICS if reader.camera else "its recording"
            return self._of_one_size(reader.observe(depth, mask, camera, color, told_by))

    def _cut_out(self, seen: Observation, box: Sequence[float] | None) -> Observation:
        return self.find(self._of_one_size(seen), box)

    def _of_one_size(self, seen: Observation) -> Observation:
        if seen.depth is not None:
            height, width = seen.depth.shape
            self._size = self._size or f"{width}x{height}"
            if (size := f"{width}x{height}") != self._size:
                raise InputError(
                    f"is {size}, earlier frames are {self._size}; intrinsics hold for one size, track them apart"
                )
        return seen


def recorded(path: Path, topics: Topics, with_cameras: bool = True) -> Iterator[FrameFile]:
    """The frames of a recording, as ``read_bag`` reads it; times count from the first one."""
    return taken(read_bag(path, topics, with_cameras))


def taken(frames: Iterable[RecordedFrame]) -> Iterator[FrameFile]:
    """Frames as they come; times count from the first one. One that is no later than another before it has that for a
    fault, and so has one far ``AHEAD`` of those before and after it, which are in order."""
    first = last = ahead = None

    def file(frame: RecordedFrame, wrong: str = "") -> FrameFile:
        fault = InputError(f"{frame.name}: was taken {wrong}") if wrong else frame.fault
        return FrameFile(Path(frame.name), frame.time - (first or 0.0), frame, fault)

    for frame in chain(frames, [None]):
        if ahead is not None:
            if frame is not None and frame.time < ahead.time:
                yield file(ahead, f"{ahead.time - frame.time:.0f} s later than the frame after it; correct its stamp")
            else:
                last = ahead.time
                yield file(ahead)
            ahead = None
        if frame is None:
            return
        first = frame.time if first is None else first
        if last is not None and frame.time > last + AHEAD:
            ahead = frame
        elif last is not None and frame.time <= last:
            yield file(frame, "no later than a frame before it; sort the recording by time")
        else:
            last = frame.time
            yield file(frame)
