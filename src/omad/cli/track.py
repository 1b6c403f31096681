"""``omad track``: follow one object through a folder or a stream of frames."""

import sys
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import OmitArgPrefixes, Positional

from omad.common.errors import InputError
from omad.common.lazy import lazy_imports
from omad.sensing.input_options import InputOptions

from .answer import Answer, as_json, as_lines
from .options import CategoryCommand, Fast, check_positive

with lazy_imports():
    from omad.applications.tracking.frames import Clock, frames_from, frames_of, read_times, read_truth
    from omad.applications.tracking.motion import MotionConfig
    from omad.applications.tracking.pictures import Film
    from omad.applications.tracking.sequence import TrackedSequence
    from omad.applications.tracking.tracker import Tracker, TrackerConfig
    from omad.common.runtime import keep_freed_memory

STREAM = Path("-")


@dataclass(frozen=True, kw_only=True)
class Track(CategoryCommand):
    """Follow one object through frames: a line of JSON a frame (joint states, standard deviations, pose, axes, status),
    a summary, a table and a plot of joint states over time.

    FRAMES is a folder of depth images or clouds, or - for a stream: file names on stdin, one a line, each answered on
    stdout by a line of JSON as soon as it is read; the last line is the summary.
    """

    frames: Positional[Path]
    """Folder of depth images or clouds, or - for file names on stdin. A frame that cannot be read is named on stderr
    and under "refused"; tracking goes on without it, and the exit code is 2. A frame without the object is no error."""
    reading: OmitArgPrefixes[InputOptions] = InputOptions()
    times: Path | None = None
    """CSV with lines name,seconds. Without it, time stamps in the files' names count (10, 13, 16 or 19 digits or a
    decimal point: s, ms, us, ns), or frame numbers in them at --fps."""
    fps: float = 30.0
    """Frames a second, where neither --times nor names hold the time."""
    fast: Fast = False
    static_base: bool = False
    """Camera and base stand still; only joints move. Steadier where it is true."""
    truth: Path | None = None
    """CSV of true joint states (columns frame and one for each joint, radians or metres), to compare with;
    default: truth.csv in the folder, where there is one."""
    output: Path = Path("omad-track")
    """Folder for frames.jsonl, states.csv, states.png and summary.json."""
    gif: bool = False
    """Also a small film of the frames with keypoints and axes, track.gif."""

    def run(self) -> Answer:
        check_positive(depth_scale=self.reading.depth_scale, fps=self.fps)
        stream = self.frames == STREAM
        if not (stream or self.frames.is_dir()):
            cure = "give a folder of depth images or clouds, or - for a stream"
            raise InputError(f"{self.frames}: no such folder; {cure}")
        clock = Clock(self.fps, None if self.times is None else read_times(self.times))
        frames = frames_from(sys.stdin, clock) if stream else frames_of(self.frames, clock)
        keep_freed_memory()
        estimator = self.estimator(self.fast)
        beside = self.frames / "truth.csv"
        path = self.truth or (beside if not stream and beside.is_file() else None)
        truth = read_truth(path, tuple(joint.name for joint in estimator.category.joints)) if path else None
        tracker = Tracker(estimator, TrackerConfig(motion=MotionConfig(static_base=self.static_base)))
        sequence = TrackedSequence(tracker, self.reading, self.output, Film() if self.gif else None, stream)
        try:
            sequence.follow(frames)
        finally:
            sequence.close()
        code = 2 if sequence.refused else 0 if any(one.status == "tracking" for one in sequence.tracked) else 1
        return Answer(sequence.finish(truth), as_json if stream else as_lines, code)
