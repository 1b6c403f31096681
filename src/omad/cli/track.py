"""``omad track``: follow one object through a folder, a stream, a recording or a camera's frames."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tyro.conf import OmitArgPrefixes, Positional

from omad.common.errors import InputError
from omad.common.files import check_folder, replacing
from omad.common.lazy import lazy_imports
from omad.common.stderr import tell
from omad.sensing.input_options import FrameOptions, InputOptions

from .answer import Answer, amount, as_json, table
from .options import CategoryCommand, Fast, check_positive

with lazy_imports():
    from omad.applications.detection.cutting import ObjectFinder
    from omad.applications.detection.detector import Detector
    from omad.applications.tracking.frames import Clock, frames_from, frames_of, read_times, read_truth
    from omad.applications.tracking.motion import MotionConfig
    from omad.applications.tracking.pictures import Film
    from omad.applications.tracking.places import CameraPlaces
    from omad.applications.tracking.recorder import Recorder
    from omad.applications.tracking.sequence import TrackedSequence, earlier_track
    from omad.applications.tracking.streams import FrameReader, recorded, taken
    from omad.applications.tracking.tracker import Tracker, TrackerConfig
    from omad.common.incoming import is_file
    from omad.common.runtime import keep_freed_memory
    from omad.estimation.world import known_gravity
    from omad.output.formats import check_formats
    from omad.sensing.foreign import realsense
    from omad.sensing.foreign.bags import Topics, is_bag

STREAM = Path("-")
FPS = 30.0


@dataclass(frozen=True)
class Recording:
    """Which topics of a recording are what; without, they are told by the kind of their messages."""

    depth_topic: str | None = None
    """sensor_msgs/Image or CompressedImage of depth."""
    info_topic: str | None = None
    """sensor_msgs/CameraInfo of the depth camera; not needed with --intrinsics."""
    color_topic: str | None = None
    """sensor_msgs/Image of colours that lie on the depth image, for pictures."""
    mask_topic: str | None = None
    """sensor_msgs/Image, not zero where the object is."""


@dataclass(frozen=True, kw_only=True)
class Track(CategoryCommand):
    """Follow one object through frames: a line of JSON a frame (joint states, standard deviations, pose, axes, status),
    a page with a slider for time (track.html), a summary, a table and a plot of joint states over time.

    FRAMES is a folder of depth images or clouds; a recording (ROS 2 MCAP or .db3, ROS 1 or RealSense .bag); or - for a
    stream: file names on stdin, one a line, each answered on stdout by a line of JSON as soon as it is read; the last
    line is the summary. With --camera realsense there are no FRAMES: a camera is followed until Ctrl-C.
    """

    frames: Positional[Path | None] = None
    """Folder of depth images or clouds, recording, or - for file names on stdin. A frame that cannot be read is named
    on stderr and under "refused"; tracking goes on without it, and the exit code is 2. A frame without the object is no
    error."""
    camera: Literal["realsense"] | None = None
    """Follow what a camera sees, in place of FRAMES: realsense (pip install 'omad[realsense]')."""
    reading: OmitArgPrefixes[InputOptions] = InputOptions()
    frame: OmitArgPrefixes[FrameOptions] = FrameOptions()
    recording: OmitArgPrefixes[Recording] = Recording()
    world: Path | None = None
    """T_world_camera, 4x4 text or NPY, or JSON with it; or a folder with one for each frame, named like it: poses are
    given in the world frame, too, and --formats of the last frame are written in it."""
    gravity: str | None = None
    """Of an object that stands upright: x,y,z, where down is in the camera frame (y is down in a level camera); or
    world, for --world with z up."""
    times: Path | None = None
    """CSV with lines name,seconds. Without it, time stamps in the files' names count (10, 13, 16 or 19 digits or a
    decimal point: s, ms, us, ns; or date and time, as 2024-05-01_12-30-05), or frame numbers in them at --fps."""
    fps: float | None = None
    """Frames a second, where neither --times nor names hold the time; default: 30."""
    most: int | None = None
    """End after so many frames."""
    fast: Fast = False
    static_base: bool = False
    """Camera and base stand still; only joints move. Steadier where it is true."""
    truth: Path | None = None
    """CSV of true joint states (columns frame and one for each joint, radians or metres), to compare with;
    default: truth.csv in the folder, where there is one."""
    output: Path = Path("omad-track")
    """Folder for track.html, frames.jsonl, states.csv, states.png and summary.json."""
    formats: tuple[str, ...] = ()
    """Write these of the last frame, too, as omad estimate does, into last/; rrd: a Rerun recording of all frames."""
    gif: bool = False
    """Also a small film of the frames with keypoints and axes, track.gif."""
    live: bool = False
    """Show it in the Rerun viewer while it is tracked (pip install 'omad[rerun]')."""

    def run(self) -> Answer:
        check_positive(depth_scale=self.reading.depth_scale, fps=self.fps, most=self.most)
        check_folder(self.output)
        if self.live and "rrd" in self.formats:
            raise InputError("--live: shows the recording in place of writing it; leave it out, or --formats rrd")
        check_formats(self.formats)
        stream = self.frames == STREAM
        if self.frames is not None and not stream and self.output.resolve() == self.frames.resolve():
            raise InputError(f"--output {self.output}: is the folder of the frames; give another")
        places = None if self.world is None else CameraPlaces(self.world)
        if self.static_base and places is not None and places.one is None:
            raise InputError("--static-base: the camera stands still, but --world is a folder; leave one of them out")
        if self.gravity == "world" and places is None:
            raise InputError("--gravity world: needs --world with T_world_camera, z up")
        if self.gravity != "world":
            known_gravity(self.gravity, None)  # a wrong one is wrong for every frame
        frames = self._frames(stream)
        keep_freed_memory()
        estimator = self.estimator(self.fast)
        check_formats(self.formats, estimator.category)
        beside = None if self.frames is None or stream else self.frames / "truth.csv"
        path = self.truth or (beside if beside is not None and beside.is_file() else None)
        truth = read_truth(path, tuple(joint.name for joint in estimator.category.joints)) if path else None
        tracker = Tracker(estimator, TrackerConfig(motion=MotionConfig(static_base=self.static_base)))
        reader = FrameReader(self.reading, self.frame, ObjectFinder(Detector([estimator])))
        sequence = TrackedSequence(
            tracker, reader, self.output, places, self.gravity, tuple(name for name in self.formats if name != "rrd"),
            Film() if self.gif else None, self._recorder(), stream,
        )  # fmt: skip
        with replacing(earlier_track(self.output)), sequence:
            try:
                sequence.follow(frames)
            except KeyboardInterrupt:
                if self.camera is None:
                    raise
                print("omad: ended", file=sys.stderr)
            summary = sequence.finish(truth)
        followed = any(one.status == "tracking" for one in sequence.tracked)
        if self.gravity is not None and not followed:
            tell(f"omad: --gravity {self.gravity}: with a wrong one nothing is followed; see whether it goes without")
        code = 2 if sequence.refused else 0 if followed else 1
        return Answer(summary, as_json if stream else track_text, code)

    def _frames(self, stream: bool) -> Iterable[Any]:
        """Raises InputError where there are none."""
        if (self.frames is None) == (self.camera is None):
            raise InputError("FRAMES or --camera: give a folder, a recording or -, or a camera to follow")
        timed = self.camera is not None or (self.frames is not None and is_bag(self.frames))
        for option in ("times", "fps"):
            if timed and getattr(self, option) is not None:
                raise InputError(f"--{option}: recordings and cameras tell the times of their frames; leave it out")
        named = [option for option, topic in vars(self.recording).items() if topic is not None]
        if named and not (self.frames is not None and is_bag(self.frames)):
            raise InputError(f"--{named[0].replace('_', '-')}: goes with a recording; leave it out")
        if self.camera is not None and self.reading.depth_scale is not None:
            raise InputError("--depth-scale: a camera tells its own; leave it out")
        if self.camera is not None:
            frames = taken(realsense.open_camera())
        elif stream:
            frames = frames_from(sys.stdin, self._clock())
        elif self.frames is not None and is_bag(self.frames):
            frames = recorded(self.frames, Topics(**vars(self.recording)), self.reading.intrinsics is None)
        elif self.frames is not None and self.frames.is_dir():
            frames = frames_of(self.frames, self._clock())
        else:
            cure = "give a folder of depth images or clouds, a recording, or - for a stream"
            wrong = "is a file that is no recording" if self.frames and is_file(self.frames) else "no such folder"
            raise InputError(f"{self.frames}: {wrong}; {cure}")
        return (frame for _, frame in zip(range(self.most), frames, strict=False)) if self.most else frames

    def _clock(self) -> Any:
        return Clock(self.fps or FPS, None if self.times is None else read_times(self.times))

    def _recorder(self) -> Any:
        if self.live:
            return Recorder.to_viewer()
        return Recorder.to_file(self.output / "track.rrd") if "rrd" in self.formats else None


def track_text(answer: dict[str, Any]) -> str:
    """A line a joint, with mean errors where the truth is known, and how the frames went."""
    rows = [["joint", "last", "lowest", "highest"]]
    errors = answer.get("errors")
    rows[0] += ["mean error", "of single frames"] if errors else []
    for index, joint in enumerate(answer["joint_states"]):
        told = [joint[f"{which}_state"] for which in ("last", "lowest", "highest")]
        told += [errors[index][which]["mean"] for which in ("tracked", "single")] if errors else []
        rows.append([joint["name"], *(amount(value, slides=joint["type"] == "prismatic") for value in told)])
    counts = ", ".join(f"{count} {status}" for status, count in answer["status"].items() if count)
    each = f", {1000 * answer['seconds_per_frame']:.0f} ms each" if answer["frames"] else ""
    lost = len(answer["refused"])
    refused = [f"refused: {lost} frames, named in summary.json"] if lost else []
    file = Path(answer["output"]) / "track.html"
    page = [f"page: {file}"] if file.is_file() else ["the object was followed in no frame, so there is no page"]
    unsure = answer["doubtful"]
    doubtful = [f"doubtful: {unsure} frames, rather wrong than right; states.csv says which"] if unsure else []
    return "\n".join(
        [table(rows), f"frames: {answer['frames']} ({counts or 'none'}{each})", *doubtful, *page, *refused]
    )
