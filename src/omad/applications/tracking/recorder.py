"""A track in Rerun: recorded in a file, or shown by the viewer while it is tracked."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from omad.common.files import publish, unfinished, writing
from omad.output.rerun import finish, imported, log_frame
from omad.sensing.observation import Observation

from .tracker import TrackedEstimate

TIMELINE = "time"


class Recorder:
    """Logs frames as they are tracked."""

    def __init__(self, rr: Any, stream: Any) -> None:
        self._rr, self._stream = rr, stream
        self._path: Path | None = None
        self._temporary: Path | None = None
        self._ending = ExitStack()

    @classmethod
    def to_file(cls, path: Path) -> Self:
        """Into a file (.rrd), which gets its name when the recorder is closed. Raises InputError without Rerun."""
        rr = imported()
        recorder = cls(rr, rr.RecordingStream("omad track"))
        with writing(path):
            temporary = recorder._ending.enter_context(unfinished(path))
        recorder._stream.save(temporary)
        recorder._path, recorder._temporary = path, temporary
        return recorder

    @classmethod
    def to_viewer(cls) -> Self:
        """To the viewer, which is started. Raises InputError without Rerun."""
        rr = imported()
        stream = rr.RecordingStream("omad track")
        stream.spawn()
        return cls(rr, stream)

    def add(self, observation: Observation | None, tracked: TrackedEstimate) -> None:
        """The next frame."""
        self._stream.set_time(TIMELINE, duration=tracked.time)
        self._stream.log("status", self._rr.TextLog(tracked.status))
        log_frame(self._rr, self._stream, observation, tracked.estimate, static=False)

    def close(self, keep: bool) -> None:
        """End the recording; its file gets its name, or is gone where it is not to be kept."""
        finish(self._stream)
        if self._path is not None and self._temporary is not None:
            with writing(self._path), self._ending:
                if keep:
                    publish(self._temporary, self._path)
