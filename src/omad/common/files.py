"""Writing files that are whole or not there."""

import errno
import json
import os
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any
from uuid import uuid4

from .errors import InputError, WorkError
from .processes.locks import try_lock

TEMPORARY = ".omad-"
"""What names of unfinished files begin with."""
OPEN_STAYS = os.name == "nt"
"""Windows neither renames nor removes a file that is open, and locks none."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
"""What goes wrong with a disk, not with a path."""
FILES = (".png", ".jpg", ".html", ".json", ".csv", ".npy", ".npz", ".urdf", ".glb", ".ply", ".zip")
"""What no folder's name ends with."""


def stamp(path: Path) -> str:
    """Another one when a file is written anew: its size and when it was written. Raises OSError."""
    status = path.stat()
    return f"{status.st_size} {int(status.st_mtime)}"  # to the second, as some file systems keep it


def write_atomic(path: str | Path, write: Callable[[Path], Any]) -> None:
    """Call ``write`` with a temporary path beside ``path``, then rename it: a crash leaves no half-written file. The
    temporary name ends in the same extension. Raises InputError where the folder cannot be written, WorkError where
    the disk is full."""
    path = Path(path)
    with writing(path), unfinished(path) as temporary:
        if path.exists() and not path.is_file():  # a device, say, whose place a file would take
            raise InputError(f"{path}: is there, and is no file; choose another name")
        write(temporary)
        publish(temporary, path)


def publish(temporary: Path, path: Path) -> None:
    """The finished file gets its name, in place of what had it."""
    temporary.chmod(_usual_mode(path.parent))  # mkstemp, and some writers, make files that only their owner may read
    temporary.replace(path)


def _usual_mode(folder: Path) -> int:
    """Who may read a new file in a folder. The umask tells, which no thread can ask for without changing it for all."""
    probe = folder / f"{TEMPORARY}{uuid4().hex}"
    handle = os.open(probe, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
    try:
        return stat.S_IMODE(os.fstat(handle).st_mode)
    finally:
        os.close(handle)
        probe.unlink(missing_ok=True)  # who sweeps may have come first


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """What goes wrong when ``path`` is written, said in one line: InputError for a path that cannot be written,
    WorkError for a disk that is full."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or one_line(error)
        if error.errno in NO_ROOM:
            raise WorkError(f"{path}: cannot be written ({reason}); what was there before is as it was") from error
        raise InputError(f"{path}: cannot be written ({reason}); choose another folder") from error
    except ValueError as error:
        if "null" in str(error):  # of a path: "embedded null byte"
            raise InputError(f"{str(path)!r}: is no path; choose another name") from error
        raise


@contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """A new file beside ``path`` to be written and then renamed to it, of the same extension; it is gone afterwards
    where that did not happen. What a killed process left of such files is taken away."""
    path.parent.mkdir(parents=True, exist_ok=True)
    _sweep(os.path.realpath(path.parent))
    handle, name = _locked_file(path)
    temporary = Path(name)
    if OPEN_STAYS:
        os.close(handle)
    try:
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        if not OPEN_STAYS:
            os.close(handle)


def _locked_file(path: Path) -> tuple[int, str]:
    """Locked as long as it is written, so that who sweeps knows it for one in use."""
    while True:
        handle, name = tempfile.mkstemp(prefix=TEMPORARY, suffix=path.suffix[:20], dir=path.parent)
        if try_lock(handle) is not False and (OPEN_STAYS or os.fstat(handle).st_nlink):
            return handle, name
        os.close(handle)  # swept in the moment before it was locked


@lru_cache(maxsize=1024)
def _sweep(folder: str) -> None:
    """Take away what killed processes left unfinished; once a folder."""
    if OPEN_STAYS:
        return
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(TEMPORARY) and entry.is_file(follow_symlinks=False):
                with suppress(OSError), open(entry.path, "r+b") as file:  # another process may take it away
                    if try_lock(file.fileno()):  # surely nobody's; where there are no locks, it stays
                        os.unlink(entry.path)


@contextmanager
def replacing(files: Iterable[Path]) -> Iterator[None]:
    """Of ``files`` that are there now, those that are not written anew within are taken away at the end, and folders of
    theirs that are empty then; all stay where something goes wrong."""
    before = {file: _state(file) for file in files if file.is_file()}
    yield
    stale = [file for file, state in before.items() if _state(file) == state]
    for file in stale:
        file.unlink()
    for folder in {file.parent for file in stale}:
        with suppress(OSError):  # others' files are in it
            folder.rmdir()


def _state(file: Path) -> tuple[int, ...] | None:
    """Another one after the file was written anew; None without it."""
    try:
        found = file.stat()
    except FileNotFoundError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


def check_folder(path: str | Path) -> None:
    """Raises InputError where a folder is to be written and a file must be meant, or is there."""
    path = Path(path)
    if path.suffix.lower() in FILES and not path.is_dir():
        raise InputError(f"{path}: is the name of a file, where a folder is written; leave out {path.suffix}")
    if path.is_file():
        raise InputError(f"{path}: is a file, where a folder is written; choose another name")


def make_folder(path: str | Path) -> None:
    """Create a folder and those above it. Raises InputError where that cannot be, and where a file must be meant."""
    check_folder(path)
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be a folder for output ({error.strerror}); choose another one") from error


def one_line(error: BaseException) -> str:
    """The message of a foreign error on one line."""
    return " ".join(str(error).split()) or type(error).__name__


def write_json(path: Path, record: dict[str, Any], indent: int | None = None) -> None:
    """Whole or not at all; on one line without an ``indent``."""
    write_text(path, json.dumps(record, indent=indent) + "\n")


def write_text(path: str | Path, text: str) -> None:
    """UTF-8, whole or not at all."""
    write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
