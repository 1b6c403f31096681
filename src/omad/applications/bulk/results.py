"""A file of results, a row an image, that goes on where it was interrupted.

Rows are appended to ``OUTPUT.part``; the file gets its name when all are there. ``OUTPUT.run`` beside it says what the
part is made of, so that no other run goes on with it. The part is locked while rows are added: the same command, given
a second time meanwhile, is refused.
"""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from omad.common.batches import batched
from omad.common.errors import InputError
from omad.common.files import make_folder, write_atomic, write_json, writing
from omad.common.incoming import read_json
from omad.common.processes.locks import try_lock
from omad.data.shards.parquet import import_pyarrow
from omad.estimation.estimate import Estimate, plain
from omad.estimation.joint_estimate import INTERVALS

from .parquet_images import SUFFIX
from .stream import Outcome

LINES = ".jsonl"
ROWS = 4096
"""A group of rows in a Parquet file of results."""


def row(outcome: Outcome) -> dict[str, Any]:
    """What is kept of an image, as plain values: the numbers of ``Estimate.to_dict`` that no other tells."""
    estimate = outcome.estimate
    if estimate is None:
        return {"name": outcome.name, "refused": outcome.refused}
    return {"name": outcome.name, "refused": None, **_numbers(estimate)}


def _numbers(estimate: Estimate) -> dict[str, Any]:
    return plain(
        {
            "category": estimate.category.name,
            "converged": estimate.converged,
            "probability": estimate.probability,
            "residual": estimate.residual,
            "mirrored": estimate.of_other_hand,
            "hand_probability": estimate.hand_probability,
            "beta": estimate.beta,
            "T_camera_base": estimate.T_camera_base,
            "base_std": estimate.base_std,
            "T_camera_part": estimate.T_camera_part,
            "joints": estimate.joints,
            "warnings": estimate.warnings,
        }
    )


@dataclass
class Results:
    """A file that is being made. Lengths are metres, angles radians, places those of the camera frame."""

    path: Path
    made_of: dict[str, Any]
    """Plain values; of others it is not to be made further."""
    done: int = 0
    """Rows that are there."""
    refused: int = 0
    """Of these, without an estimate."""
    last: str | None = None
    """Name of the last one's image."""
    size: int = 0
    """Bytes of these rows."""

    @classmethod
    def open(cls, path: Path, made_of: dict[str, Any], batch: int = 1) -> Self:
        """Begin, or go on with what a run ``made_of`` the same (plain values) left: with whole batches of ``batch``
        rows, as rounding depends on what is worked on together. Raises InputError where there are other results, where
        another run is at it, or the file's format is unknown."""
        if path.suffix not in (LINES, SUFFIX):
            raise InputError(f"--output {path}: give a name that ends in {LINES} or {SUFFIX}")
        if path.suffix == SUFFIX:
            import_pyarrow()  # rather now than after a day's work
        if path.exists():
            raise InputError(f"{path}: is there already; delete it, or give another --output")
        results = cls(path, made_of)
        make_folder(path.parent)
        if results.part.exists() and not results.part.is_file():  # a pipe would be waited for
            raise InputError(f"{results.part}: is no file; delete it, or give another --output")
        if not results.part.exists() or not results.part.stat().st_size:
            return results
        if read_json(results.run, f"delete {results.part}, or give another --output") != made_of:
            raise InputError(f"{results.part}: made with other inputs or settings; delete it, or give another --output")
        results._resume(batch)
        return results

    @property
    def part(self) -> Path:
        """What is made so far."""
        return self.path.with_name(f"{self.path.name}.part")

    @property
    def run(self) -> Path:
        """What it is made of."""
        return self.path.with_name(f"{self.path.name}.run")

    def add(self, outcomes: Iterable[Outcome]) -> Iterable[Outcome]:
        """The same outcomes, each of them written before it is handed on. Raises InputError where another run is at it,
        or was since this one began."""
        with writing(self.part):
            file = self.part.open("ab")
        with self._closing(file):
            self._lock(file)
            if file.tell() != self.size:
                raise InputError(f"{self.part}: another run has added rows; run this one again")
            if not self.size:
                write_json(self.run, self.made_of)  # before the first row, and by the one run that writes it
            for outcome in outcomes:
                with writing(self.part):
                    file.write(json.dumps(row(outcome)).encode() + b"\n")
                    file.flush()  # what is done is on disk, whatever ends this process
                self.size = file.tell()
                self.done += 1
                self.refused += outcome.estimate is None
                yield outcome

    def finish(self) -> None:
        """Give the file its name."""
        if self.path.suffix == LINES:
            with writing(self.path):
                self.part.replace(self.path)
        else:
            write_atomic(self.path, self._write_parquet)
            self.part.unlink(missing_ok=True)
        self.run.unlink(missing_ok=True)

    def _resume(self, batch: int) -> None:
        """Take the whole batches that are there; the last line may be half written."""
        place = count = refused = 0
        with self.part.open("r+b") as file:
            self._lock(file)
            for line in file:
                try:
                    found = json.loads(line) if line.endswith(b"\n") else None
                except (ValueError, RecursionError):
                    found = None
                if not isinstance(found, dict) or not {"refused", "name"} <= found.keys():
                    break
                place, count, refused = place + len(line), count + 1, refused + (found["refused"] is not None)
                if count % batch == 0:
                    self.size, self.done, self.refused, self.last = place, count, refused, found["name"]
            file.truncate(self.size)

    @contextmanager
    def _closing(self, file: IO[bytes]) -> Iterator[None]:
        try:
            yield
        finally:
            with writing(self.part):  # what could not be written is tried again
                file.close()

    def _lock(self, file: IO[bytes]) -> None:
        """As long as the part's ``file`` is open."""
        if try_lock(file.fileno()) is False:
            raise InputError(f"{self.part}: another run is writing it; wait for its end, or give another --output")

    def _write_parquet(self, path: Path) -> None:
        pyarrow, schema = import_pyarrow(), row_schema()
        with self.part.open("rb") as file, pyarrow.parquet.ParquetWriter(path, schema) as writer:
            for lines in batched(file, ROWS):
                writer.write_table(pyarrow.Table.from_pylist([json.loads(line) for line in lines], schema))


def row_schema() -> Any:
    """pyarrow.Schema of what ``row`` keeps."""
    pyarrow = import_pyarrow()
    text, number, truth = pyarrow.string(), pyarrow.float64(), pyarrow.bool_()
    numbers = pyarrow.list_(number)
    joint = {"name": text, "type": text, "state": number, "state_std": number, "fraction": number}
    joint |= {"limits": numbers, "axis": numbers, "pivot": numbers, "pitch": number}
    joint |= {f"interval_{level}": numbers for level in INTERVALS}
    columns = {"name": text, "refused": text, "category": text, "converged": truth, "probability": number}
    columns |= {"residual": number, "mirrored": truth, "hand_probability": number}
    columns |= {"beta": numbers, "T_camera_base": pyarrow.list_(numbers), "base_std": numbers}
    columns |= {"T_camera_part": pyarrow.list_(pyarrow.list_(numbers))}
    columns |= {"joints": pyarrow.list_(pyarrow.struct(joint)), "warnings": pyarrow.list_(text)}
    return pyarrow.schema(columns)
