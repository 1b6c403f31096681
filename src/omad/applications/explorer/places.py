"""Which files the explorer's page may name: those below a folder that was given at start, and those it was given."""

import os
import re
from dataclasses import dataclass
from pathlib import Path

from omad.common.errors import InputError, shown

LONGEST = 100
"""Characters of an uploaded file's name that are kept."""


@dataclass(frozen=True)
class Places:
    """Files that may be read for whoever sees the page."""

    folders: tuple[Path, ...] = ()
    files: tuple[Path, ...] = ()

    def checked(self, text: str) -> Path:
        """The path that a text names. Raises InputError where it lies elsewhere; whether there is such a file, it does
        not tell."""
        refused = InputError(f"{shown(text)}: not in the folder that was given with --folder; upload the file instead")
        try:
            path = Path(text).expanduser()
            real = Path(os.path.realpath(path))
        except (OSError, ValueError, RuntimeError):
            raise refused from None
        if real in (Path(os.path.realpath(file)) for file in self.files):
            return path
        if not any(real.is_relative_to(os.path.realpath(folder)) for folder in self.folders):
            raise refused
        return path


def plain_name(name: str) -> str:
    """A name for an uploaded file that is nothing but a name, with its extension."""
    kept = re.sub(r"[^\w.-]", "_", name.replace("\\", "/").rpartition("/")[2], flags=re.ASCII).lstrip(".")
    return kept[-LONGEST:].lstrip(".") or "file"
