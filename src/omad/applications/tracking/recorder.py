"""A track in Rerun: recorded in a file, or shown by the viewer while it is tracked."""

from pathlib import Path
from typing import Any, Self

from omad.common.files import publish, writing
from omad.output.rerun import finish, imported, log_frame
from omad.sensing.observation import Observation

from .tracker import TrackedEstimate

TIMELINE = "time"
UNFINISHED = ".unfinished.rrd"


class Recorder:
    """Logs frames as they are tracked."""

    def __init__(self, rr: Any, stream: Any, path: Path | None = None) -> None:
        self._rr, self._stream, self._path = rr, stream, path

    @classmethod
    def to_file(cls, path: Path) -> Self:
        """Into a file (.rrd), which gets its name when the recorder is closed. Raises InputError without Rerun."""
        rr = imported()
        stream = rr.RecordingStream("omad track")
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        stream.save(path.with_suffix(UNFINISHED))
        return cls(rr, stream, path)

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

    def close(self) -> None:
        """End the recording."""
        finish(self._stream)
        if self._path is not None:
            with writing(self._path):
                publish(self._path.with_suffix(UNFINISHED), self._path)
