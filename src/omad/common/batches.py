"""Going through many things: a few at a time, and telling a person how far one is."""

import sys
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import TypeVar

from tqdm import tqdm

T = TypeVar("T")


def batched(things: Iterable[T], size: int) -> Iterator[list[T]]:
    """Lists of ``size`` things, in order; the last one may be shorter."""
    rest = iter(things)
    return iter(lambda: list(islice(rest, size)), [])


def progress(things: Iterable[T], total: int | None, unit: str = "view") -> Iterable[T]:
    """The same things, with a bar on stderr where a person watches."""
    return tqdm(things, total=total, unit=unit, file=sys.stderr, disable=not sys.stderr.isatty())
