"""Locks between processes. They end with the process that holds them, however it ends, and leave no file behind."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError


def try_lock(handle: int) -> bool:
    """Lock an open file or folder; whether that worked. Where there are no locks (Windows, some network's file
    systems), it always does."""
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        return True
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
        if not try_lock(handle):
            raise InputError(f"{folder}: {what} is writing here already; wait for its end, or choose another folder")
        yield
    finally:
        os.close(handle)
