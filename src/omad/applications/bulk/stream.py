"""Many observations through one estimator, on all cores, as a stream.

Threads, not processes: reading, the network and compiled loops run without the interpreter's lock, so that on two cores
threads give as many images a second as processes do, with one copy of the weights and nothing to start or to send.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from numbers import Integral
from threading import Lock
from typing import Any, Self, TypeVar

import numpy as np
import torch

from omad.common.arrays import as_numpy
from omad.common.batches import batched
from omad.common.errors import InputError, shown
from omad.common.files import one_line
from omad.common.runtime import cores
from omad.estimation.checks import depth_doubts, warned
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.sensing.observation import Observation

T = TypeVar("T")

MOST = 1024
"""Workers, and images that go through the network together."""
IN_FLIGHT = 3
"""Batches that are read, worked on or waiting to be taken, a worker."""


@dataclass(frozen=True)
class Frame:
    """One observation to come: read by the worker that estimates it, so that no other thread waits for that."""

    name: str
    """Of it in the results."""
    load: Callable[[], Observation]
    """Raises InputError where it is bad."""

    @classmethod
    def of_depth(cls, name: str, depth_m: Any, K: Any = None, mask: Any = None, **options: Any) -> Self:
        """A depth image, as ``Observation.from_depth`` takes it. Arrays are copied: a camera may put its next image
        there before this one is read."""
        given = {"depth_m": depth_m, "K": K, "mask": mask, **options}
        return cls(name, partial(Observation.from_depth, **{key: _copied(value) for key, value in given.items()}))


@dataclass(frozen=True)
class Outcome:
    """What became of one frame."""

    name: str
    """Of a bare observation: its place in the stream, from 0."""
    estimate: Estimate | None
    """None where it was refused."""
    refused: str | None = None
    """Why there is no estimate, on one line."""


def estimate_stream(
    estimator: Estimator,
    frames: Iterable[Frame | Observation],
    workers: int = 0,
    batch: int = 16,
) -> Iterator[Outcome]:
    """Estimates in the order of ``frames``, which may be endless: so many as ``IN_FLIGHT`` batches a worker are taken
    ahead of what the caller has taken. A frame that cannot be read or estimated is told of in its place, and the
    others go on; where ``frames`` itself raises, what came before is told of first. ``workers`` threads, 0: a core
    each, in each of which PyTorch has one thread."""
    for name, value, least in (("workers", workers, 0), ("batch", batch, 1)):
        if not isinstance(value, Integral) or not least <= value <= MOST:
            raise InputError(f"{name} {shown(repr(value))}: give a whole number from {least} to {MOST}")
    workers = workers or cores()
    try:
        frames = iter(frames)
    except TypeError as error:
        raise InputError(f"frames: is {type(frames).__name__}; give observations, or omad.Frame of each") from error
    waiting: deque[Future[list[Outcome]]] = deque()
    source = _Source(frames)
    pool = ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,))
    with _one_thread_each():
        try:
            for some in batched(_named(source), batch):
                waiting.append(pool.submit(_outcomes, estimator, some))
                if len(waiting) >= IN_FLIGHT * workers:
                    yield from waiting.popleft().result()
            while waiting:
                yield from waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
    if source.error is not None:
        raise source.error


@dataclass
class _Streams:
    """How many run, and what their threads were before the first."""

    lock: Lock = field(default_factory=Lock)
    running: int = 0
    threads: int = 1


_STREAMS = _Streams()


class _Source:
    """Things up to where the next one cannot be had: what came before is not lost, and why is kept."""

    def __init__(self, things: Iterable[Any]) -> None:
        self._things = things
        self.error: Exception | None = None

    def __iter__(self) -> Iterator[Any]:
        try:
            yield from self._things
        except Exception as error:
            self.error = error


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Threads that begin meanwhile have one of PyTorch's, as the workers do, which says so for the whole process; those
    that begin when the last of several streams has ended have as many as before."""
    with _STREAMS.lock:
        if not _STREAMS.running:
            _STREAMS.threads = torch.get_num_threads()
        _STREAMS.running += 1
    try:
        yield
    finally:
        with _STREAMS.lock:
            _STREAMS.running -= 1
            if not _STREAMS.running:
                torch.set_num_threads(_STREAMS.threads)


def _copied(value: Any) -> Any:
    """What is no array as it is."""
    return as_numpy(value).copy() if isinstance(value, np.ndarray | torch.Tensor) else value


def _named(frames: Iterable[Frame | Observation]) -> Iterator[Frame]:
    for index, frame in enumerate(frames):
        yield frame if isinstance(frame, Frame) else Frame(str(index), partial(_itself, frame))


def _itself(observation: Observation) -> Observation:
    return observation


def _outcomes(estimator: Estimator, frames: Sequence[Frame]) -> list[Outcome]:
    """Of one batch, in order."""
    read = [attempt(frame.load) for frame in frames]
    found = _asked_for_depth(read, estimates_of(estimator, read))
    rows = [(None, why(each)) if isinstance(each, Exception) else (each, None) for each in found]
    return [Outcome(frame.name, *row) for frame, row in zip(frames, rows, strict=True)]


def _asked_for_depth(
    read: Sequence[Observation | Exception], answers: Sequence[Estimate | Exception]
) -> Iterator[Estimate | Exception]:
    """Answers with what is to be doubted where images do not hold depth. Those of one batch are alike, mostly: while
    the first holds depth, the others, which would take half as long again, are not asked."""
    alike = False
    for view, answer in zip(read, answers, strict=True):
        if not alike and isinstance(view, Observation) and isinstance(answer, Estimate):
            doubts = [*depth_doubts(view)]
            alike, answer = not doubts, warned(answer, doubts)
        yield answer


def estimates_of(estimator: Estimator, read: Sequence[Observation | Exception]) -> list[Estimate | Exception]:
    """Of each observation, worked on together, or why there is none; what could not be read stays as it is."""
    views = [view for view in read if not isinstance(view, Exception)]
    together = attempt(lambda: estimator(views))
    if isinstance(together, Exception):  # where one spoils the batch, each is tried alone
        answers = iter([attempt(partial(estimator, view)) for view in views])
    else:
        answers = iter(together)
    return [view if isinstance(view, Exception) else next(answers) for view in read]


def attempt(work: Callable[[], T]) -> T | Exception:
    """What it returns, or how it failed: nothing that one frame holds may end the others' work."""
    try:
        return work()
    except Exception as error:
        return error


def why(error: Exception) -> str:
    """What a frame is refused for, on one line."""
    return one_line(error) if isinstance(error, InputError) else f"{type(error).__name__}: {one_line(error)}"
