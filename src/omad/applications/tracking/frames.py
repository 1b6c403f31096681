"""Frames in order: which files they are, and when each was taken."""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from omad.common.errors import InputError, shown
from omad.common.incoming import existing, read_text
from omad.sensing.foreign.bags import RecordedFrame
from omad.sensing.reader import input_files

from .tracker import LATEST

DIGITS, COUNTED = 30, 8
"""Of a number with a decimal point, and of one that counts frames, at most."""
DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_.]?(\d\d)[-_.]?(\d\d)[-_T ]?(\d\d)[-_:.]?(\d\d)[-_:.]?(\d\d)[.,]?(\d{0,9})Z?$"
)
"""A date and a time of day down to seconds or parts of them, with or without what parts them."""
SAYS_DEPTH = re.compile(r"([._-][a-z]+)*[._-]depth$", re.IGNORECASE)
"""What stands behind the number in names as ``000010_depth`` and ``000010-aligned_depth``."""
STAMPS = {19: 1e-9, 16: 1e-6, 13: 1e-3, 10: 1.0}
"""Seconds per unit of a time stamp since 1970 by its number of digits; one that begins with a zero is a count."""


@dataclass(frozen=True)
class FrameFile:
    """One frame of a sequence."""

    path: Path
    time: float
    """Seconds since the first frame, or as the line of a stream tells them; nan where it is not known, as the ``fault``
    says."""
    source: RecordedFrame | None = None
    """Of a recording or a camera; ``path`` is then but its name."""
    fault: InputError | None = None
    """Why it cannot be used."""


@dataclass
class Clock:
    """Tells when a frame was taken: by a table, or by its name, or by counting.

    A name that ends in 10, 13, 16 or 19 digits, or in a number with a decimal point, is a time stamp in seconds, ms,
    us or ns, as is one that ends in a date and a time of day; one that ends in a shorter number, or in one that begins
    with a zero, is that frame of ``fps`` a second, so that missing frames leave a gap.
    """

    fps: float
    table: dict[str, float] | None = None
    """Seconds by file name or stem."""
    first: float | None = None
    count: int = 0

    def __call__(self, path: Path) -> float:
        """Seconds since the first frame asked for. Raises InputError for a file that the table does not name."""
        time = self._read(path)
        self.count += 1
        self.first = time if self.first is None else self.first
        return time - self.first

    def _read(self, path: Path) -> float:
        if self.table is not None:
            found = self.table.get(path.name, self.table.get(path.stem))
            if found is None:
                raise InputError(f"{path}: the table of times has no line for it; add one, or leave --times out")
            return found
        stem = SAYS_DEPTH.sub("", path.stem)
        number = re.search(r"(\d+)(\.\d+)?$", stem)
        digits = "" if number is None else number[1]
        unit = None if digits.startswith("0") else STAMPS.get(len(digits))
        if unit is None and (told := _date_in(stem)) is not None:
            return told
        if number is None:
            return self.count / self.fps
        most = DIGITS if number[2] or unit else COUNTED
        if len(number[0].lstrip("0")) > most:
            raise InputError(f"{shown(path)}: its number is no time; give the times with --times")
        if number[2]:
            return float(number[0]) * (unit or 1.0)
        return int(number[0]) / self.fps if unit is None else int(number[0]) * unit


def _date_in(stem: str) -> float | None:
    """Seconds since 1970 of the date and time that a name ends in; None where it ends in none."""
    if (found := DATE.search(stem)) is not None:
        *whole, parts = found.groups()
        with suppress(ValueError):  # digits that are no date
            return datetime(*map(int, whole), tzinfo=UTC).timestamp() + float(f"0.{parts or 0}")
    return None


def frames_of(folder: Path, clock: Clock) -> list[FrameFile]:
    """The frames of a folder by time. Raises InputError for a folder without any, and for two of one time."""
    paths = sorted(input_files([folder]), key=_in_counting_order)
    times = [clock(path) for path in paths]
    first = min(times)  # of a table, which may have them in another order
    frames = sorted(map(FrameFile, paths, (time - first for time in times)), key=lambda frame: frame.time)
    for one, other in zip(frames, frames[1:], strict=False):
        if one.time == other.time:
            cure = "give the times with --times" if clock.table is None else "correct the table of times"
            raise InputError(f"{other.path}: has the same time as {one.path.name}; {cure}")
    return frames


def frames_from(lines: Iterable[str], clock: Clock) -> Iterator[FrameFile]:
    """Frames named one a line; after a tab a line may hold the time in seconds. One without a time that can be told, or
    with one of another clock than that of the first, has a ``fault``: the others go on."""
    timed: bool | None = None
    for line in lines:
        name, _, told = line.rstrip("\r\n").partition("\t")
        if not name:
            continue
        try:
            if timed is not None and timed != bool(told):
                has, have = ("a time", "none") if told else ("no time", "one")
                raise InputError(f"{shown(name)}: has {has}, lines before it have {have}; give each one or none")
            yield FrameFile(Path(name), _told_seconds(name, told) if told else clock(Path(name)))
            timed = bool(told)
        except InputError as error:
            yield FrameFile(Path(name), math.nan, fault=error)


def _told_seconds(name: str, told: str) -> float:
    """Raises InputError."""
    try:
        return seconds_of(told)
    except ValueError as error:
        raise InputError(f"{shown(name)}: time {shown(told)!r} is no number of seconds; correct the line") from error


def seconds_of(text: str) -> float:
    """Raises ValueError for what is no time."""
    seconds = float(text)
    if not abs(seconds) < LATEST:
        raise ValueError("not a time")
    return seconds


def read_times(path: Path) -> dict[str, float]:
    """Seconds by file name from a CSV of lines ``name,seconds``; a head line is skipped. Raises InputError."""
    times: dict[str, float] = {}
    for number, row in enumerate(read_rows(path), 1):
        if not row:
            continue
        if (name := row[0].strip()) in times:
            raise InputError(f"{path}: line {number} names {shown(name)} again; leave one out")
        try:
            times[name] = seconds_of(row[1])
        except (IndexError, ValueError) as error:
            if number > 1:
                raise InputError(f"{path}: line {number} is not 'name,seconds'; correct it") from error
    if not times:
        raise InputError(f"{path}: holds no line 'name,seconds'")
    return times


def read_truth(path: Path, joints: tuple[str, ...]) -> dict[str, list[float]]:
    """Joint states by file name from a CSV with a column ``frame`` and one for each joint: radians or metres."""
    rows = read_rows(path)
    head = [name.strip() for name in rows[0]] if rows else []
    missing = [name for name in ("frame", *joints) if name not in head]
    if missing:
        raise InputError(f"{path}: has no column {missing[0]!r}; needed: frame, {', '.join(joints)}")
    frame, columns = head.index("frame"), [head.index(name) for name in joints]
    try:
        return {row[frame].strip(): [_state(row[column]) for column in columns] for row in rows[1:] if row}
    except (IndexError, ValueError) as error:
        raise InputError(f"{path}: a line is short or holds no number ({error}); correct it") from error


def _state(text: str) -> float:
    """Raises ValueError."""
    if not math.isfinite(state := float(text)):
        raise ValueError(f"{text.strip()} is no state")
    return state


def read_rows(path: Path) -> list[list[str]]:
    """Rows of a CSV file. Raises InputError."""
    try:
        text = read_text(existing(path, "a CSV file"))
        return list(csv.reader(io.StringIO(text, newline="")))
    except csv.Error as error:
        raise InputError(f"{path}: not readable as CSV; give a text file with commas") from error


def _in_counting_order(path: Path) -> list[tuple[int, str]]:
    """Frame 2 comes before frame 10, zeros in front or not."""
    return [
        (int(word), "") if word.isdecimal() and len(word) < 1000 else (-1, word)
        for word in re.split(r"(\d+)", path.name)
    ]
