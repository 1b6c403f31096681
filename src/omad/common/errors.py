"""The exceptions that mean: here is what went wrong, and what to do about it."""

from typing import Any

SHOWN = 160
"""Characters of a foreign reader's own message, and of either half of a path."""


class InputError(ValueError):
    """Bad input. The message is one line that names the file or field and the cure; the command line exits with 2."""


class NothingSeen(InputError):
    """The frame is in order, and the object is not in it: too few measured points where it should be."""


class WorkError(RuntimeError):
    """The input was in order and the work failed. One line; the command line exits with 1."""


def shown(path: Any) -> str:
    """A path as messages name it; an endless one is cut."""
    text = str(path)
    return text if len(text) < 2 * SHOWN else f"{text[:SHOWN]}..."
