"""Going through many things: a few at a time, and telling a person how far one is."""

import sys
import time
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import TypeVar

from tqdm import tqdm

from .stderr import is_watched, tell

T = TypeVar("T")


def batched(things: Iterable[T], size: int) -> Iterator[list[T]]:
    """Lists of ``size`` things, in order; the last one may be shorter."""
    rest = iter(things)
    return iter(lambda: list(islice(rest, size)), [])


def progress(
    things: Iterable[T], total: int | None, unit: str = "view", done: int = 0, every: float | None = None
) -> Iterable[T]:
    """The same things, with a bar on stderr where a person watches; elsewhere a line ``every`` so many seconds, where
    that is given. ``done``: of the ``total``, those that an earlier run has done."""
    watched = is_watched()
    if not watched and every is not None:
        return _told(things, total, unit, done, every)
    return tqdm(things, total=total, initial=done, unit=unit, file=sys.stderr, disable=not watched)


def _told(things: Iterable[T], total: int | None, unit: str, done: int, every: float) -> Iterator[T]:
    began = told = time.monotonic()
    for count, thing in enumerate(things, 1):
        yield thing
        now = time.monotonic()
        if now - told >= every:
            rate, told = count / (now - began), now
            of = "" if total is None else f" of {total}"
            tell(f"{done + count}{of} {unit}s, {rate:.1f} a second")
