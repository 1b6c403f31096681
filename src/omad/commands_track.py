"""``omad track``: follow one object through a folder or a stream of frames."""

from __future__ import annotations

import csv
import json as json_module
import os
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TextIO

import numpy as np
import tyro
from tqdm import tqdm

from .categories import Category
from .errors import InputError, NothingSeen
from .estimator import Estimator
from .files import write_atomic
from .inputs import InputReader
from .observation import Observation
from .options import CategoryName, Device, Result, Weights, check_category, check_positive
from .report import save
from .runtime import keep_freed_memory
from .tracking.frames import Clock, FrameFile, frames_from, frames_of, read_times, read_truth
from .tracking.pictures import Film, states_over_time
from .tracking.summary import summarise
from .tracking.tracker import TrackedEstimate, Tracker, TrackerConfig

STREAM = Path("-")


@dataclass(frozen=True)
class Track:
    """Follow one object through frames: a line of JSON a frame (joint states, standard deviations, pose, axes, status),
    a summary, a table and a plot of joint states over time.

    FRAMES is a folder of depth images or clouds, or - for a stream: file names on stdin, one a line, each answered on
    stdout by a line of JSON as soon as it is read; the last line is the summary.
    """

    frames: tyro.conf.Positional[Path]
    """Folder of depth images or clouds, or - for file names on stdin. A frame that cannot be read is named on stderr
    and under "refused"; tracking goes on without it, and the exit code is 2. A frame without the object is no error."""
    category: CategoryName
    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file (Open3D or RealSense JSON, ROS YAML, 3x3 text)."""
    times: Path | None = None
    """CSV with lines name,seconds. Without it, time stamps in the files' names count (10, 13, 16 or 19 digits or a
    decimal point: s, ms, us, ns), or frame numbers in them at --fps."""
    fps: float = 30.0
    """Frames a second, where neither --times nor names hold the time."""
    static_base: bool = False
    """Camera and base stand still; only joints move. Steadier where it is true."""
    mask: Path | None = None
    """Image, non-zero where the object is; or a folder with a mask for each frame, of the same name."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels around the object, half-open, in all frames."""
    segment: Literal["plane"] | None = None
    """plane: take away the dominant plane and keep the largest thing on it (tens of milliseconds a frame)."""
    depth_scale: float | None = None
    """Metres per stored number; default 0.001 for integer images, 1 for floats and clouds."""
    truth: Path | None = None
    """CSV of true joint states (columns frame and one for each joint, radians or metres), to compare with;
    default: truth.csv in the folder, where there is one."""
    output: Path = Path("omad-track")
    """Folder for frames.jsonl, states.csv, states.png and summary.json."""
    gif: bool = False
    """Also a small film of the frames with keypoints and axes, track.gif."""
    weights: Weights = None
    device: Device = "cpu"
    print_json: Annotated[bool, tyro.conf.arg(name="json")] = False
    """Print the summary as one JSON object on stdout and nothing else there."""

    @property
    def json(self) -> bool:
        """A stream is always answered in JSON."""
        return self.print_json or self.frames == STREAM

    def run(self) -> Result:
        check_positive(depth_scale=self.depth_scale, fps=self.fps)
        clock = Clock(self.fps, None if self.times is None else read_times(self.times))
        frames = frames_from(sys.stdin, clock) if self.frames == STREAM else frames_of(self._folder(), clock)
        keep_freed_memory()
        estimator = Estimator.from_pretrained(self.weights or self.category, self.device)
        check_category("--weights", self.weights, estimator.category, self.category)
        truth = self._truth(estimator.category)
        config = TrackerConfig()
        config = replace(config, motion=replace(config.motion, static_base=self.static_base))
        run = _Run(self, Tracker(estimator, config), Film() if self.gif else None)
        try:
            run.through(frames)
        finally:
            run.close()
        answer = run.finish(truth)
        seen = any(one.status == "tracking" for one in run.tracked)
        return 2 if run.refused else 0 if seen else 1, answer

    def _folder(self) -> Path:
        if not self.frames.is_dir():
            raise InputError(
                f"{self.frames}: no such folder; give a folder of depth images or clouds, or - for a stream"
            )
        return self.frames

    def _truth(self, category: Category) -> dict[str, list[float]] | None:
        beside = self.frames / "truth.csv"
        path = self.truth or (beside if self.frames != STREAM and beside.is_file() else None)
        return None if path is None else read_truth(path, tuple(joint.name for joint in category.joints))


@dataclass
class _Run:
    """One sequence on its way."""

    command: Track
    tracker: Tracker
    film: Film | None
    files: list[FrameFile] = field(default_factory=list)
    tracked: list[TrackedEstimate] = field(default_factory=list)
    refused: list[dict[str, str]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    reader: InputReader | None = None
    size: tuple[int, ...] | None = None
    lines: TextIO | None = None

    def through(self, frames: Iterable[FrameFile]) -> None:
        """Track frame by frame. A line is written as soon as its frame is done."""
        stream = self.command.frames == STREAM
        bar = tqdm(frames, unit="frame", file=sys.stderr, disable=stream or not sys.stderr.isatty())
        for frame in bar:
            began = time.perf_counter()
            try:
                observation = self._read(frame.path)
                tracked = self.tracker(observation, frame.time)
            except InputError as error:
                self._refuse(frame, error)
                continue
            self.seconds.append(time.perf_counter() - began)
            self.files.append(frame)
            self.tracked.append(tracked)
            self._write({"frame": frame.path.name, **tracked.to_dict()})
            if self.film is not None:
                self.film.add(observation, tracked)

    def _read(self, path: Path) -> Observation | None:
        """None where the frame is in order and shows nothing."""
        if self.reader is None:
            self.reader = InputReader.of(self.command, [path])
        try:
            observation = self.reader(path)
        except NothingSeen:
            return None
        if observation.depth is not None:
            self.size = self.size or observation.depth.shape
            if observation.depth.shape != self.size:
                height, width = self.size
                raise InputError(
                    f"{path}: is {observation.depth.shape[1]}x{observation.depth.shape[0]}, earlier frames are"
                    f" {width}x{height}; intrinsics hold for one size, track them apart"
                )
        return observation

    def _refuse(self, frame: FrameFile, error: InputError) -> None:
        reason = " ".join(str(error).split())
        if str(frame.path) not in reason:
            reason = f"{frame.path}: {reason}"
        if self.reader is None and self.command.frames != STREAM:
            raise InputError(reason) from error  # the options are wrong for every frame
        print(f"omad: {reason}", file=sys.stderr)
        self.refused.append({"frame": frame.path.name, "reason": reason})
        self._write({"frame": frame.path.name, "time": frame.time, "status": "refused", "reason": reason})

    def _write(self, answer: dict[str, Any]) -> None:
        text = json_module.dumps(answer)
        if self.lines is None:
            self._open()
        assert self.lines is not None
        self.lines.write(text + "\n")
        if self.command.frames == STREAM:
            print(text, flush=True)

    def _open(self) -> None:
        """Lines go to a name of their own until all are there."""
        path = self.command.output / f".frames-{os.getpid()}.jsonl"
        write_atomic(path, lambda temporary: None)
        self.lines = path.open("w", encoding="utf-8")

    def close(self) -> None:
        """End the file of lines, whole or not."""
        if self.lines is not None:
            self.lines.close()
            Path(self.lines.name).replace(self.command.output / "frames.jsonl")

    def finish(self, truth: dict[str, list[float]] | None) -> dict[str, Any]:
        """Write table, plot, film and summary; returns the summary."""
        folder, category = self.command.output, self.tracker.estimator.category
        true = None if truth is None else [truth.get(f.path.name, truth.get(f.path.stem)) for f in self.files]
        summary: dict[str, Any] = {
            "category": category.name,
            "output": str(folder),
            **summarise(category, self.tracked, true),
            "seconds_per_frame": float(np.median(self.seconds)) if self.seconds else None,
            "beta": self.tracker.shape.mean.tolist(),
            "refused": self.refused,
        }
        if self.tracked:
            save(states_over_time(category, self.tracked, true), folder / "states.png")
            write_atomic(folder / "states.csv", lambda path: self._table(path, category))
        film, times = self.film, [one.time for one in self.tracked]
        if film is not None and film.pictures:
            write_atomic(folder / "track.gif", lambda path: film.save(path, max(times) - min(times)))
        text = json_module.dumps(summary, indent=1) + "\n"
        write_atomic(folder / "summary.json", lambda path: path.write_text(text))
        return summary

    def _table(self, path: Path, category: Category) -> None:
        """states.csv: one line a frame; empty where a state is not known."""
        names = [joint.name for joint in category.joints]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            head = [column for name in names for column in (name, f"{name}_std", f"{name}_single")]
            writer.writerow(["frame", "time", "status", *head])
            for frame, one in zip(self.files, self.tracked, strict=True):
                row: list[Any] = []
                for j in range(len(names)):
                    joint = None if one.estimate is None else one.estimate.joints[j]
                    row += ["", ""] if joint is None else [f"{joint.state:.6f}", f"{joint.state_std:.6f}"]
                    row.append("" if one.single is None else f"{one.single.joints[j].state:.6f}")
                writer.writerow([frame.path.name, f"{frame.time:.6f}", one.status, *row])
