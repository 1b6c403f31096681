"""What a person is told while a program works, if there is one who reads it."""

import sys
from contextlib import suppress


def tell(line: str) -> None:
    """A line on stderr; nothing where that was closed, or its reader has gone."""
    if sys.stderr is not None:
        with suppress(OSError, ValueError):
            print(line, file=sys.stderr, flush=True)


def is_watched() -> bool:
    """Whether a person watches stderr."""
    return sys.stderr is not None and sys.stderr.isatty()
