"""A sequence on its way through the tracker, and what is written of it: lines, page, table, plot, film, recording, and
a summary, which tells how long the object was followed, and where truth is known how well."""

import csv
import json
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self, TextIO

import numpy as np

from omad.common.batches import progress
from omad.common.errors import InputError, NothingSeen, WorkError
from omad.common.files import one_line, publish, unfinished, write_atomic, write_json, writing
from omad.common.incoming import read_json
from omad.estimation.estimate import Estimate, plain
from omad.estimation.world import in_world, known_gravity
from omad.objects.category import Category
from omad.output.formats import files_of_answer, save_formats
from omad.output.picture import save
from omad.sensing.observation import Observation

from .frames import FrameFile
from .page import TrackPage
from .pictures import Film, Truth, states_over_time
from .places import CameraPlaces
from .recorder import Recorder
from .tracker import TrackedEstimate, TrackedStates, Tracker

FRAMES = "frames.jsonl"
SUMMARY = "summary.json"
LAST = "last"
FORMULA = tuple("=+-@")
"""What spreadsheets take a cell for that begins so."""
TRIED = 3
"""First frames that may be broken; where more are, it is the options that are wrong."""
OF_A_TRACK = (FRAMES, "states.csv", "states.png", "track.html", "track.gif", "track.rrd")
"""Files of a track beside its summary; some tracks have all of them."""


@dataclass
class TrackedSequence:
    """Follows one object frame by frame into the files of a folder."""

    tracker: Tracker
    read: Callable[[FrameFile], Observation]
    """Of a frame. Raises InputError, and NothingSeen where it is in order and shows nothing."""
    output: Path
    places: CameraPlaces | None = None
    """Of the camera in the world: poses are then given there, too."""
    gravity: str | None = None
    """As ``known_gravity`` takes it."""
    formats: tuple[str, ...] = ()
    """Written of the last frame in which the object was followed; a Rerun recording of all of them."""
    film: Film | None = None
    recorder: Recorder | None = None
    stream: bool = False
    """Frames come while they are tracked: each is answered on stdout, and even the first may be refused."""
    files: list[FrameFile] = field(default_factory=list)
    tracked: list[TrackedStates] = field(default_factory=list)
    refused: list[dict[str, str]] = field(default_factory=list)
    untold: list[FrameFile] = field(default_factory=list)
    """Of the refused ones the last, while it may be that all are."""
    seconds: list[float] = field(default_factory=list)
    page: TrackPage = field(default_factory=TrackPage)
    last: tuple[Estimate, Observation, np.ndarray | None] | None = None
    """Of the last frame that was followed, with ``T_world_camera`` where that is known."""
    began: bool = False
    """A frame could be read."""
    lines: TextIO | None = None
    ending: ExitStack = field(default_factory=ExitStack)
    """Takes away what is unfinished."""

    def follow(self, frames: Iterable[FrameFile]) -> None:
        """Track frame by frame. A line is written as soon as its frame is done. A frame that cannot be used is named
        under ``refused``; raises InputError where the options are wrong for every frame."""
        for frame in frames if self.stream else progress(frames, None, "frame"):
            began = time.perf_counter()
            try:
                observation = self._read(frame)
                T_world_camera = None if self.places is None else self.places(frame)
                tracked = self.tracker(observation, frame.time, known_gravity(self.gravity, T_world_camera))
            except WorkError:
                raise
            except (InputError, ArithmeticError, ValueError, RuntimeError, TypeError) as error:
                self._refuse(frame, error)  # whatever one frame holds, the others go on
                continue
            self.seconds.append(time.perf_counter() - began)
            self.files.append(replace(frame, source=None))  # images of hours of frames are not kept
            self.tracked.append(TrackedStates.of(tracked, len(self.tracker.estimator.category.joints)))
            record = {"frame": frame.path.name, **tracked.to_dict()}
            if T_world_camera is not None and tracked.estimate is not None:
                record["world"] = in_world(tracked.estimate, T_world_camera)
            self._write(record)
            if observation is not None and tracked.status == "tracking" and tracked.estimate is not None:
                self.last = tracked.estimate, observation, T_world_camera
            self._draw(frame, observation, tracked)
        if self.refused and not (self.began or self.stream):
            raise InputError(self.refused[-1]["reason"])

    def _draw(self, frame: FrameFile, observation: Observation | None, tracked: TrackedEstimate) -> None:
        self.page.add(frame.path.name, observation, tracked)
        if self.film is not None:
            self.film.add(observation, tracked)
        if self.recorder is not None:
            self.recorder.add(observation, tracked)

    def _read(self, frame: FrameFile) -> Observation | None:
        """None where the frame is in order and shows nothing."""
        if frame.fault is not None:
            raise frame.fault
        try:
            observation = self.read(frame)
        except NothingSeen:
            observation = None
        self.began = True
        self._tell_refused()
        return observation

    def _refuse(self, frame: FrameFile, error: Exception) -> None:
        reason = one_line(error)
        if str(frame.path) not in reason:
            reason = f"{frame.path}: {reason}"
        self.refused.append({"frame": frame.path.name, "reason": reason})
        self.untold.append(frame)
        if self.began or self.stream:
            self._tell_refused()
        elif len(self.refused) > TRIED:
            raise InputError(reason) from error  # the options are wrong for every frame

    def _tell_refused(self) -> None:
        for frame, refused in zip(self.untold, self.refused[-len(self.untold) :], strict=False):
            print(f"omad: {refused['reason']}", file=sys.stderr)
            self._write({"time": frame.time, "status": "refused", **refused})
        self.untold.clear()

    def _write(self, answer: dict[str, Any]) -> None:
        text = json.dumps(plain(answer), allow_nan=False)
        if self.lines is None:
            with writing(self.output / FRAMES):  # under another name until all lines are there
                temporary = self.ending.enter_context(unfinished(self.output / FRAMES))
                self.lines = temporary.open("w", encoding="utf-8")
        with writing(self.output / FRAMES):
            self.lines.write(text + "\n")
        if self.stream:
            print(text, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the files that were written meanwhile. What was cut short is kept, too, but does not take the place of an
        earlier track's."""
        keep = kind is None or not (self.output / SUMMARY).is_file()
        if self.lines is not None:
            with writing(self.output / FRAMES), self.ending:
                self.lines.close()
                if keep:
                    publish(Path(self.lines.name), self.output / FRAMES)
        if self.recorder is not None:
            self.recorder.close(keep)

    def finish(self, truth: dict[str, list[float]] | None) -> dict[str, Any]:
        """Write page, table, plot, film, formats and summary; returns the summary."""
        folder, category = self.output, self.tracker.estimator.category
        true = None if truth is None else [truth.get(f.path.name, truth.get(f.path.stem)) for f in self.files]
        seconds = float(np.median(self.seconds)) if self.seconds else None
        summary = {"category": category.name, "output": str(folder), **summarise(category, self.tracked, true)}
        summary |= {"seconds_per_frame": seconds, "beta": self.tracker.shape.mean.tolist(), "refused": self.refused}
        summary["parts"] = [part.name for part in category.parts]
        if self.tracked:
            save(states_over_time(category, self.tracked, true), folder / "states.png")
            write_atomic(folder / "states.csv", lambda path: self._table(path, category))
        self.page.save(folder / "track.html", f"{category.name}: {len(self.tracked)} frames")
        if self.last is not None:
            estimate, observation, T_world_camera = self.last
            save_formats(estimate, observation, folder / LAST, self.formats, T_world_camera)
        if (film := self.film) is not None and film.pictures:
            lasting = self.tracked[-1].time - self.tracked[0].time
            write_atomic(folder / "track.gif", lambda path: film.save(path, lasting))
        write_json(folder / SUMMARY, summary, indent=1)
        return summary

    def _table(self, path: Path, category: Category) -> None:
        """states.csv: one line a frame; empty where a state is not known."""
        names = [joint.name for joint in category.joints]
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            head = [f"{name}{of}" for name in names for of in ("", "_std", "_single")]
            writer.writerow(["frame", "time", "status", *head, "probability"])
            for frame, one in zip(self.files, self.tracked, strict=True):
                name = frame.path.name
                name = f"'{name}" if name[:1] in FORMULA else name
                row = [name, f"{frame.time:.6f}", one.status]
                row += ["" if np.isnan(value) else f"{value:.6f}" for value in one.told.T.ravel()]
                writer.writerow([*row, "" if one.probability is None else f"{one.probability:.3f}"])


def earlier_track(folder: Path) -> list[Path]:
    """Where an earlier track lies in ``folder``, its files but the summary."""
    try:
        parts = [str(name) for name in read_json(folder / SUMMARY, "")["parts"]]
    except (InputError, LookupError, TypeError):  # none of ours
        return []
    return [folder / name for name in OF_A_TRACK] + files_of_answer(folder / LAST, parts)


def summarise(category: Category, tracked: Sequence[TrackedStates], truth: Truth | None = None) -> dict[str, Any]:
    """Frames by status and how many are doubtful, the last joint states, and their range; with ``truth`` the errors of
    tracked and single answers on the same frames. Radians and metres."""
    statuses = [one.status for one in tracked]
    seen = np.array([one.told[0] for one in tracked if one.status != "lost"])
    states: list[list[Any]] = [[None] * 3] * len(category.joints)
    if len(seen):
        states = np.stack([seen[-1], seen.min(0), seen.max(0)], 1).tolist()
    joints: list[dict[str, Any]] = []
    for spec, (last, low, high) in zip(category.joints, states, strict=True):
        found = {"last_state": last, "lowest_state": low, "highest_state": high}
        joints.append({"name": spec.name, "type": spec.type, **found})
    counts = {status: statuses.count(status) for status in ("tracking", "coasting", "lost")}
    summary = {"frames": len(tracked), "status": counts, "tracks": sum(one.restarted for one in tracked)}
    summary["doubtful"] = sum(one.doubtful for one in tracked)
    summary |= {"last_status": statuses[-1] if statuses else None, "joint_states": joints}
    return summary if truth is None else summary | {"errors": _errors(category, tracked, truth)}


def _errors(category: Category, tracked: Sequence[TrackedStates], truth: Truth) -> list[dict[str, Any]]:
    used = []
    for one, true in zip(tracked, truth, strict=True):
        if one.status == "tracking" and true is not None:
            used.append(one.told[[0, 2]] - true)
    errors = np.array(used).reshape(-1, 2, len(category.joints)).transpose(2, 1, 0)
    joints = zip(category.joints, errors, strict=True)
    return [{"name": j.name, "frames": len(used), "tracked": spread(a), "single": spread(b)} for j, (a, b) in joints]


def spread(error: np.ndarray) -> dict[str, float | None]:
    """Mean and 95th percentile of |error| (frames,), and its jitter: the standard deviation of its differences from
    frame to frame."""
    if len(error) < 2:
        return {"mean": None, "p95": None, "jitter": None}
    size, jitter = np.abs(error), np.diff(error).std()
    return {"mean": float(size.mean()), "p95": float(np.percentile(size, 95)), "jitter": float(jitter)}
