"""Reading JSON; writing files that are whole or not there."""

import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .errors import InputError


def write_atomic(path: str | Path, write: Callable[[Path], Any]) -> None:
    """Call ``write`` with a temporary path beside ``path``, then rename it: a crash leaves no half-written file. The
    temporary name ends in the same extension. Raises InputError where the folder cannot be written."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            write(temporary)
            os.umask(umask := os.umask(0))
            temporary.chmod(0o666 & ~umask)  # mkstemp, and some writers, make files that only their owner may read
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another folder") from error


def make_folder(path: str | Path) -> None:
    """Create a folder and those above it. Raises InputError where that cannot be."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be a folder for output ({error.strerror}); choose another one") from error


def one_line(error: Exception) -> str:
    """The message of a foreign error on one line."""
    return " ".join(str(error).split()) or type(error).__name__


def write_json(path: Path, record: dict[str, Any], indent: int | None = None) -> None:
    """Whole or not at all; on one line without an ``indent``."""
    write_text(path, json.dumps(record, indent=indent) + "\n")


def write_text(path: str | Path, text: str) -> None:
    """UTF-8, whole or not at all."""
    write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def read_json(path: Path, cure: str) -> Any:
    """What a JSON file holds. Raises InputError, with the ``cure``, for one that is missing or broken."""
    if not path.is_file():
        raise InputError(f"{path}: missing; {cure}")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not readable as JSON ({one_line(error)}); {cure}") from error
