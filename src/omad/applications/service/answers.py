"""Requests of one category, answered together: what is sent back for each."""

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from omad.common.errors import InputError, shown
from omad.common.files import one_line
from omad.estimation.estimator import Estimator
from omad.objects.builtin import AUTO
from omad.output.page import page_text
from omad.sensing.observation import Observation

from ..bulk.stream import attempt, estimates_of, why
from ..solver import Found, Solver
from .asked import Asked, in_fields
from .reply import Reply

PIXELS = 20_000_000
"""Of images that are held at a time, but for the last one ..."""
SECONDS = 0.5
"""... and that it takes to read them, but for the last: to find an object in its image may take seconds."""


@dataclass(frozen=True)
class _Read:
    """A request whose image was read, or could not be."""

    asked: Asked
    view: Observation | Exception
    seconds: float

    @classmethod
    def of(cls, asked: Asked, solver: Solver) -> "_Read":
        began = time.perf_counter()
        view = attempt(partial(asked.observation, solver.find))
        return cls(asked, view, time.perf_counter() - began)

    @property
    def pixels(self) -> int:
        depth = None if isinstance(self.view, Exception) else self.view.depth
        return 0 if depth is None else depth.size


class Answers:
    """Answers of ``omad estimate`` by estimators that are loaded."""

    def __init__(self, estimators: Sequence[Estimator]) -> None:
        """One a category."""
        every = {estimator.category.name: Solver(estimator, lambda: estimators) for estimator in estimators}
        self._solvers = {**every, AUTO: Solver(None, lambda: estimators)}

    @property
    def categories(self) -> list[str]:
        """Those that can be asked for, without auto."""
        return [name for name in self._solvers if name != AUTO]

    def check(self, asked: Asked) -> None:
        """Raises InputError for a category that is not served."""
        if asked.category not in self._solvers:
            raise InputError(
                f"category {shown(repr(asked.category))}: not served; choose of {', '.join(self._solvers)}"
            )

    def __call__(self, batch: Iterable[Asked]) -> Iterator[Reply]:
        """For each of a batch that asks for one category, as they are made; nothing that is in one of them touches the
        others."""
        for some in self._few(batch):
            yield from _replies(some, self._solvers[some[0].asked.category])

    def _few(self, batch: Iterable[Asked]) -> Iterator[list[_Read]]:
        """Read, so many at a time as may be held, and wait, together."""
        held: list[_Read] = []
        for asked in batch:
            held.append(_Read.of(asked, self._solvers[asked.category]))
            if sum(each.pixels for each in held) >= PIXELS or sum(each.seconds for each in held) >= SECONDS:
                yield held
                held = []
        if held:
            yield held


def _replies(read: list[_Read], solver: Solver) -> Iterator[Reply]:
    if solver.chosen is None:
        found = (attempt(partial(_of_any, each, solver)) for each in read)
    else:
        estimates = estimates_of(solver.chosen, [each.view for each in read])
        rows = zip(read, estimates, strict=True)
        found = (attempt(partial(_judged, each, estimate, solver)) for each, estimate in rows)
    return (_reply(each, answer) for each, answer in zip(read, found, strict=True))


def _of_any(read: _Read, solver: Solver) -> Found:
    if isinstance(read.view, Exception):
        raise read.view
    return solver(read.view, read.asked.metres_per_number, further=read.asked.checks == "all")


def _judged(read: _Read, estimate: Any, solver: Solver) -> Found:
    if isinstance(estimate, Exception):
        raise estimate
    assert isinstance(read.view, Observation)
    return solver.judged(read.view, estimate, read.asked.metres_per_number, further=read.asked.checks == "all")


def _reply(read: _Read, found: Found | Exception) -> Reply:
    made = found if isinstance(found, Exception) else attempt(partial(_told, read, found))
    if not isinstance(made, Exception):
        return made
    if isinstance(made, InputError):
        return Reply.failed(400, in_fields(one_line(made)))
    print(f"omad: a request failed: {why(made)}", file=sys.stderr, flush=True)
    return Reply.failed(500, "the work failed; the server's log says more")


def _told(read: _Read, found: Found) -> Reply:
    found = found.with_seconds(read=read.seconds)
    if found.none or read.asked.format == "json":
        record = found.none_of_them() if found.none else found.to_dict()
        checks = [{key: in_fields(told) for key, told in check.items()} for check in record["checks"]]
        return Reply.of(200, record | {"warnings": [*map(in_fields, record["warnings"])], "checks": checks})
    assert isinstance(read.view, Observation)
    doubts = read.view.warnings + tuple(str(check) for check in found.checks)
    page = page_text(read.view, replace(found.estimate, warnings=tuple(map(in_fields, doubts))))
    return Reply(200, page.encode(), "text/html; charset=utf-8")
