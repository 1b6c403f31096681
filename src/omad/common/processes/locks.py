"""Locks between processes. They end with the process that holds them, however it ends, and leave no file behind."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError


def try_lock(handle: int) -> bool | None:
    """Lock an open file or folder; whether that worked. None where nobody can tell, as there are no locks: on Windows,
    and on some network's file systems, of which others lock only what is open for writing."""
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        return None
    return True


@contextmanager
def only_one(folder: Path, what: str) -> Iterator[None]:
    """Nobody else writes into ``folder`` meanwhile. Raises InputError where another process does; ``what``: as "a
    training"."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:  # Windows opens no folders
        yield
        return
    try:
        if try_lock(handle) is False:
            raise InputError(f"{folder}: {what} is writing here already; wait for its end, or choose another folder")
        yield
    finally:
        os.close(handle)
