"""The exceptions that mean: here is what went wrong, and what to do about it."""

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

SHOWN = 160
"""Characters of a foreign reader's own message, and of either half of a path."""

LONGEST = 4000
"""Characters of a message."""


class InputError(ValueError):
    """Bad input. The message is one line that names the file or field and the cure; the command line exits with 2."""

    def __init__(self, message: str) -> None:
        super().__init__(_shortened(message))


class NothingSeen(InputError):
    """The frame is in order, and the object is not in it: too few measured points where it should be."""


class WorkError(RuntimeError):
    """The input was in order and the work failed. One line; the command line exits with 1."""

    def __init__(self, message: str) -> None:
        super().__init__(_shortened(message))


def _shortened(message: str) -> str:
    return as_line(message if len(message) <= LONGEST else f"{message[:LONGEST]}...")


def unknown(name: str, known: Iterable[str]) -> str:
    """A name that is none of the ``known`` ones as a message has it, with the one that may be meant."""
    near = difflib.get_close_matches(name, list(known), 1)
    return f"{name!r} ({near[0]}?)" if near else repr(name)


def as_line(text: str) -> str:
    """Without what would break the line, or tell a terminal to do something: names of files may hold it."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def shown(path: Any) -> str:
    """A path as messages name it; an endless one is cut."""
    text = str(path)
    return text if len(text) < 2 * SHOWN else f"{text[:SHOWN]}..."


@contextmanager
def named(path: Any) -> Iterator[None]:
    """An InputError from within names the file, if it does not yet."""
    try:
        yield
    except InputError as error:
        raise type(error)(str(error) if str(path) in str(error) else f"{path}: {error}") from error
