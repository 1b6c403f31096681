"""What is done about broken files of a source of views."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from omad.common.errors import InputError

Broken = Literal["refuse", "skip"]
"""Stop at the first, or leave out what they belong to and list it."""


@contextmanager
def passing_over(broken: Broken, left_out: list[dict[str, str]], name: str) -> Iterator[None]:
    """Whether an InputError inside ends the work or is noted down."""
    try:
        yield
    except InputError as error:
        if broken == "refuse":
            raise InputError(f"{error} (or leave out what is broken with --broken skip)") from error
        entry = {"name": name, "reason": str(error)}
        if entry not in left_out:  # images may be read more than once
            print(f"left out {name}: {error}", file=sys.stderr)
            left_out.append(entry)
