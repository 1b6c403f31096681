"""What a large catalogue consists of, in one small file: what is not named there does not exist.

Files are written under new names; then ``manifest.json`` is replaced, which is the moment in which they count. Whoever
is killed before it leaves files that nobody reads, and the next writer takes away.
"""

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Literal

from omad.common.errors import InputError
from omad.common.files import write_json
from omad.common.incoming import is_file, read_record

from ..signature import Metric

FILE = "manifest.json"
FORMAT = "omad-large-index-1"
CURE = "copy the whole folder anew, or build it anew"
OWN_FILE = re.compile(r"(part|lists|centres)-\d{6,}\.[a-z.]+")
"""Names of the files beside it."""


@dataclass(frozen=True)
class StoredPart:
    """Entries that were added together."""

    name: str
    entries: int
    sizes: tuple[int, int, int]
    """Bytes of its files: betas, texts and pictures, and where these end."""


@dataclass(frozen=True)
class StoredLists:
    """What searches consecutive parts."""

    name: str
    entries: int


@dataclass(frozen=True)
class Manifest:
    """Everything of a catalogue that is not an entry."""

    prior: str
    category: str
    metric: Metric
    factor: tuple[tuple[float, ...], ...]
    """Of the ``Space``."""
    covariances: tuple[tuple[float, ...], ...]
    """Sum of those of all entries."""
    format: Literal["omad-large-index-1"] = FORMAT
    number: int = 0
    """Of the newest file: names are used once."""
    parts: tuple[StoredPart, ...] = ()
    lists: tuple[StoredLists, ...] = ()
    centres: str | None = None
    """Name of the file with the lists' centres."""
    centres_for: int = 0
    """Entries that these were chosen for."""
    taken: tuple[tuple[str, int], ...] = ()
    """Of each source, how many of its inputs are in ..."""
    names: tuple[tuple[str, str], ...] = ()
    """... and of some what tells these from others: a digest of their names, or of their betas."""

    @property
    def entries(self) -> int:
        """Of all parts."""
        return sum(part.entries for part in self.parts)


def read_manifest(folder: Path) -> Manifest:
    """Raises InputError."""
    if not is_file(folder / FILE):
        raise InputError(f"{folder}: no {FILE} in it; give a catalogue, as omad index build --backend disk makes it")
    return read_record(Manifest, folder / FILE, CURE)


def publish_manifest(folder: Path, manifest: Manifest) -> None:
    """From here on the catalogue is what it says; files that it does not name are taken away."""
    write_json(folder / FILE, asdict(manifest))
    named = {part.name for part in manifest.parts} | {lists.name for lists in manifest.lists} | {manifest.centres}
    for path in folder.iterdir():
        if OWN_FILE.fullmatch(path.name) and path.name.split(".")[0] not in named:
            with suppress(PermissionError):  # on Windows, as long as it is read: gone with the next one
                path.unlink(missing_ok=True)


def digest_of_names(names: Sequence[str]) -> str:
    """Tells some names in their order from others."""
    return sha256("\0".join(names).encode(errors="surrogateescape")).hexdigest()[:32]


def to_disk(path: Path) -> None:
    """Wait until the file is: its name in the manifest must not be there before."""
    with path.open("r+b") as file:  # Windows flushes only what may be written
        os.fsync(file.fileno())
