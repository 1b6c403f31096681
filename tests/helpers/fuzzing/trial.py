"""One bad input, and what may come of it: a line that says what is wrong, or an answer of numbers."""

import contextlib
import io
import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omad.cli.main import run
from omad.common.errors import InputError, WorkError

from .spoiling import any_bytes, no_file, spoil

LONGEST = 20_000
"""Characters of a message."""
OPTIONS = [
    "-1",
    "0",
    "1",
    "nan",
    "inf",
    "-inf",
    "1e300",
    "1e9",
    "-0.0",
    "9" * 30,
    "",
    "x",
    "../..",
    "/dev/null",
    "/dev/zero",
    "/etc/passwd",
    "x" * 5000,
    "a\0b",
    "\udcff",
    "$x$",
    "1,2,3",
    "nan,nan,nan,nan",
    "0,0,0,0",
    "1e300,1e300,0,0",
    "-600,600,320,240",
    "5,5,1,1",
    "inf,0,inf,9",
    "~",
    "-",
    "cpu",
    "cuda",
    "privateuseone",
    "meta",
    "laptop",
    "auto",
    "none",
    "k1,k2",
    "9,9,9,9,9",
    "equidistant:9,9,9,9",
    "1e-300,600,320,240",
    "world",
    "0,0,0",
    "nan,0,1",
    ".",
    "/",
    "procedural",
    "paper",
]
"""In place of what is given with an option."""
HERE = b"@here@"
"""In files: the folder that they lie in."""
KEPT = "someone-elses"
"""A folder beside that of the trial, which no command is told of."""


@dataclass(frozen=True)
class Target:
    """A reader."""

    name: str
    files: dict[str, bytes]
    """By path, what is good; all are there, and one is spoilt."""
    use: Callable[[Path], Any]
    """Reads them from a folder; gives numbers, or anything."""
    spoilt: tuple[str, ...] = ()
    """Of the files; empty: any."""

    def attempt(self, rng: np.random.Generator, folder: Path) -> str | None:
        """Read a spoilt copy in an empty ``folder``: None where it is refused in one line or gives numbers that are
        finite; else what went wrong."""
        place = str(rng.choice(sorted(self.spoilt or self.files)))
        _write(self.files, folder)
        _spoil(folder / place, rng)
        try:
            with _quiet():
                found = self.use(folder)
        except (InputError, WorkError) as error:
            return None if _is_line(text := str(error)) else f"{place}: no line: {text[:200]!r}"
        except Exception as error:
            return f"{place}: {_where(error)}"
        return None if _finite(found) else f"{place}: an answer that is not a number"


@dataclass(frozen=True)
class Command:
    """A command line, run in a folder of files."""

    name: str
    arguments: tuple[str, ...]
    files: dict[str, bytes]
    spoilt: tuple[str, ...] = ()
    """Of the files; empty: any."""
    stdin: str = ""

    def attempt(self, rng: np.random.Generator, folder: Path) -> str | None:
        """The same of a command whose files or options are spoilt; it must say what is wrong on one line of stderr, and
        leave alone what it was not told of."""
        inside, outside = folder / "here", folder / KEPT
        _write(self.files, inside)
        _write({"kept.txt": b"kept", "model/model.urdf": b"<robot/>"}, outside)
        before = _listed(outside)
        arguments, stdin, done = list(self.arguments), self.stdin, "as it is"
        values = [i for i, word in enumerate(arguments) if i and arguments[i - 1].startswith("--") and word[:2] != "--"]
        values = [i for i in values if arguments[i - 1] not in ("--steps", "--objects", "--views", "--device")]
        if values and rng.random() < 0.25:
            index = values[rng.integers(len(values))]
            words = (
                OPTIONS if arguments[index - 1] != "--output" else [word for word in OPTIONS if word[:1] not in "/~."]
            )
            arguments[index] = str(rng.choice(words))
            done = " ".join(arguments[index - 1 : index + 1])[:60]
        elif stdin and rng.random() < 0.5:
            stdin, done = any_bytes(stdin.encode(), rng).decode("utf-8", "replace"), "stdin"
        elif self.files:
            done = str(rng.choice(sorted(self.spoilt or self.files)))
            _spoil(inside / done, rng)
        failure = _run(arguments, stdin, inside)
        if failure is None and (_listed(outside) != before or {*os.listdir(folder)} != {inside.name, KEPT}):
            failure = "wrote outside of its folder"
        return failure and f"{done}: {failure}"


@dataclass(frozen=True)
class Call:
    """A function with arguments of a caller's program, of which one is spoilt."""

    name: str
    use: Callable[..., Any]
    good: tuple[Any, ...]
    odd: tuple[Any, ...]

    def attempt(self, rng: np.random.Generator, folder: Path) -> str | None:
        """As of a reader."""
        index, value = int(rng.integers(len(self.good))), self.odd[rng.integers(len(self.odd))]
        if isinstance(value, Spoiler):
            value = value(self.good[index], rng)
        done = f"argument {index} {type(value).__name__!s} {str(value)[:40]!r}"
        try:
            with _quiet():
                found = self.use(*self.good[:index], value, *self.good[index + 1 :])
        except (InputError, WorkError) as error:
            return None if _is_line(text := str(error)) else f"{done}: no line: {text[:200]!r}"
        except Exception as error:
            return f"{done}: {_where(error)}"
        return None if _finite(found) else f"{done}: an answer that is not a number"


@dataclass(frozen=True)
class Spoiler:
    """An odd argument that is made of the good one."""

    make: Callable[[Any, np.random.Generator], Any]

    def __call__(self, good: Any, rng: np.random.Generator) -> Any:
        return self.make(good, rng)


def _run(arguments: list[str], stdin: str, folder: Path) -> str | None:
    """What is wrong with how a command ends, if anything."""
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.chdir(folder), _quiet(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            sys.stdin = io.StringIO(stdin)
            code = run(arguments)
    except SystemExit as error:
        code = error.code  # tyro has said what is wrong
        return None if code in (0, 2) else f"exit code {code}"
    except BaseException as error:
        return _where(error)
    finally:
        sys.stdin = sys.__stdin__
    if "Traceback" in err.getvalue():
        return f"traceback on stderr: {err.getvalue()[-200:]!r}"
    if left := [path for path in folder.rglob(".omad-*") if path.is_file()]:
        return f"left {left[0].name}"
    lines = [line for line in err.getvalue().splitlines() if line.startswith("omad: ")]
    if code not in (0, 1, 2) or (code == 2 and not (lines or out.getvalue())):
        return f"exit code {code} and {len(lines)} lines"
    if not all(map(_is_line, lines)):
        return "a message without end"
    return None if code == 2 or _numbers(out.getvalue()) else "an answer that is not a number"


def _numbers(said: str) -> bool:
    """Whether what a command prints with --json is JSON, and where it is an estimate, all its places are numbers."""
    for line in said.splitlines():
        if not line.startswith("{"):
            continue
        try:
            record = json.loads(line, parse_constant=lambda name: float(name))
        except ValueError:
            return False
        for found in [record, *record.get("results", [])]:
            if "single_joint_states" in found:
                continue  # of a frame, which may show nothing
            places = [[joint["state"], joint["state_std"], joint["axis"]] for joint in found.get("joints") or []]
            if not _all_numbers([places, found.get("T_camera_base", 0), found.get("beta", 0)]):
                return False
    return True


def _all_numbers(value: Any) -> bool:
    if isinstance(value, list):
        return all(map(_all_numbers, value))
    return isinstance(value, int | float) and math.isfinite(value)


def _write(files: dict[str, bytes], folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.replace(HERE, str(folder.resolve()).encode()))


def _spoil(path: Path, rng: np.random.Generator) -> None:
    if rng.random() < 0.1:
        no_file(path, rng)
    else:
        path.write_bytes(spoil(path.read_bytes(), path.name, rng))


def _listed(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _where(error: BaseException) -> str:
    """An error, with the line of the project's that it came through last."""
    place, trace = "", error.__traceback__
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        if "omad" in file.parts and "helpers" not in file.parts:
            place = f"{file.name}:{trace.tb_lineno} "
        trace = trace.tb_next
    return f"{place}{type(error).__name__}: {str(error)[:200]}"


def _is_line(text: str) -> bool:
    return "\n" not in text and 0 < len(text) < LONGEST


def _finite(found: Any) -> bool:
    if isinstance(found, np.ndarray) and found.dtype.kind == "f":
        return bool(np.isfinite(found).all())
    return not isinstance(found, float) or math.isfinite(found)
