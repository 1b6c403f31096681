"""A pure function over the shards of something long, whose rows become a Parquet file each; beside them lies what the
rows are made of, so that no other run goes on with them (``data/shards/parquet.py``).

A shard's file depends on the work and its number alone, and is there when all of it is: whoever does a shard a second
time, because the first one's machine died or a run is given again, finds it or writes the same.
"""

import io
import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

from omad.common.batches import progress
from omad.common.errors import InputError, WorkError
from omad.common.incoming import parse_json
from omad.data.rendering.view_folder import DATASET
from omad.data.shards.parquet import RUN, import_pyarrow, part_name
from omad.data.shards.store import Store

META = b"omad"
MOST = 10_000_000
"""Rows of a shard."""


class Work(Protocol):
    """What is done to a shard. It is sent to other processes, and loads what it needs there once."""

    def __call__(self, start: int, stop: int) -> list[dict[str, Any]]:
        """Rows of the inputs from ``start`` to before ``stop``, as plain values: one for each, in order."""
        ...

    def schema(self) -> Any:
        """pyarrow.Schema of the rows."""
        ...

    def refused(self, row: dict[str, Any]) -> bool:
        """Whether a row only tells why there is no answer."""
        ...


@dataclass(frozen=True)
class Done:
    """A shard that is there."""

    number: int
    rows: int
    refused: int = 0
    error: str | None = None
    """One line, where it could not be made."""
    bad_input: bool = False
    """Whether what it is made of is bad, which no other try will mend."""


@dataclass(frozen=True)
class Plan:
    """All of a run."""

    store: Store
    work: Work
    total: int
    """Inputs."""
    size: int
    """Of a shard; the last one may be smaller."""

    @property
    def shards(self) -> int:
        """How many."""
        return -(-self.total // self.size)

    def __call__(self, number: int) -> Done:
        """Make a shard, or find it."""
        start, stop = number * self.size, min(self.total, (number + 1) * self.size)
        try:
            if self.store.has(part_name(number)):
                return self.found(number)
            rows = self.work(start, stop)
            if len(rows) != stop - start:
                what = f"{len(rows)} rows of {stop - start} inputs"
                raise InputError(f"{part_name(number)}: {what}; have they changed?")
            done = Done(number, len(rows), sum(map(self.work.refused, rows)))
            self.store.write(part_name(number), _parquet(rows, self.work.schema(), done))
        except InputError as error:
            return Done(number, 0, error=str(error), bad_input=True)
        return done

    def found(self, number: int) -> Done:
        """What is there. Raises InputError for a file that was changed."""
        name = part_name(number)
        with self.store.open(name) as file:
            try:
                told = json.loads(import_pyarrow().parquet.read_schema(file).metadata[META])
                return Done(number, told["rows"], told["refused"])
            except Exception as error:
                place = f"{self.store.place}/{name}"
                raise InputError(f"{place}: is none of this run's files; delete it, and run again") from error

    def rows(self) -> Iterator[dict[str, Any]]:
        """Of all shards, in order, once they are there."""
        parquet = import_pyarrow().parquet
        for number in range(self.shards):
            with self.store.open(part_name(number)) as file:
                yield from parquet.read_table(file).to_pylist()


Engine: TypeAlias = Callable[[Plan, list[int]], Iterable[Done]]
"""Makes the shards of a plan that have these numbers, in any order and on any machine; each at least once."""


@dataclass
class Report:
    """What became of a run."""

    rows: int = 0
    refused: int = 0
    earlier: int = 0
    """Of the rows, those that an earlier run had made."""
    seconds: float = 0.0
    shards: set[int] = field(default_factory=set)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        rate = (self.rows - self.earlier) / self.seconds if self.seconds else 0.0
        told = {"images": self.rows, "refused": self.refused, "shards": len(self.shards), "done_before": self.earlier}
        return {**told, "seconds": self.seconds, "images_per_second": rate}

    def add(self, done: Done) -> bool:
        """Whether it is new: a cluster may tell of a shard twice, where a machine died."""
        if done.number in self.shards:
            return False
        self.shards.add(done.number)
        self.rows += done.rows
        self.refused += done.refused
        return True


@dataclass(frozen=True)
class Sharded:
    """A run that is done."""

    plan: Plan
    report: Report

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"output": self.plan.store.place, **self.report.to_dict()}


def run_shards(plan: Plan, made_of: dict[str, Any], engine: Engine) -> Report:
    """Make all shards that are not there yet; ``made_of``: what rows depend on, as plain values. Raises InputError
    where other results are there or what the work is made of is bad, WorkError where shards are missing at the end."""
    if not 1 <= plan.size <= MOST:
        raise InputError(f"--shard {plan.size}: must be from 1 to {MOST}")
    import_pyarrow()  # rather now than on all machines
    _begin(plan, made_of)
    there, report, began = plan.store.names(), Report(), time.perf_counter()
    missing = []
    for number in range(plan.shards):
        if part_name(number) in there:
            report.add(plan.found(number))
        else:
            missing.append(number)
    report.earlier = report.rows
    for _ in progress(_images(plan, missing, engine, report), plan.total, "image", report.rows, every=30.0):
        pass
    report.seconds = time.perf_counter() - began
    if lost := set(range(plan.shards)) - report.shards:
        raise WorkError(f"{plan.store.place}: {len(lost)} of {plan.shards} shards are missing; run it again")
    return report


def _images(plan: Plan, missing: list[int], engine: Engine, report: Report) -> Iterator[None]:
    """Something for each new row."""
    for done in engine(plan, missing) if missing else ():
        if done.error is not None:
            raise InputError(done.error) if done.bad_input else WorkError(f"{done.error}; run it again")
        if report.add(done):
            yield from (None for _ in range(done.rows))


def _begin(plan: Plan, made_of: dict[str, Any]) -> None:
    """Refuse to mix two runs."""
    record = {**made_of, "total": plan.total, "shard": plan.size}
    there, place = plan.store.names(), plan.store.place
    if RUN in there:
        if parse_json(plan.store.read(RUN), f"{place}/{RUN}") != json.loads(json.dumps(record)):
            raise InputError(f"{place}: holds what was made of other inputs or settings; give another --output")
    elif DATASET in there or any(name.startswith("part-") for name in there):
        raise InputError(f"{place}: holds files of another program; give another --output")
    else:
        plan.store.write(RUN, json.dumps(record).encode())


def _parquet(rows: list[dict[str, Any]], schema: Any, done: Done) -> bytes:
    pyarrow = import_pyarrow()
    told = json.dumps({"rows": done.rows, "refused": done.refused}).encode()
    table = pyarrow.Table.from_pylist(rows, schema.with_metadata({META: told}))
    file = io.BytesIO()
    pyarrow.parquet.write_table(table, file, compression="zstd")
    return file.getvalue()
