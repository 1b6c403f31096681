"""Entries on disk: betas as an array, texts and pictures one after the other, and where each ends; where hands are
known, a fourth number with the ends: 1 of an object of the other hand, 0 of none such, -1 of one that nobody knows.

Whatever is asked for is read where it lies; a part of a million entries costs no memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Self

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import is_file, map_array

from ..index import Entry, with_hands
from ..signature import Signature, prior_of
from .manifest import CURE, StoredPart, to_disk

BETAS, BLOB, ENDS = ".betas.npy", ".entries", ".ends.npy"
UNKNOWN = -1
MAPPED = 64
"""Parts that are kept mapped."""


@dataclass(frozen=True, eq=False)
class Portion:
    """Entries on their way into a catalogue."""

    betas: np.ndarray
    """(n, D)."""
    entries: Sequence[Entry]
    """What is said of each."""
    covariances: np.ndarray
    """(D, D) sum of the known ones."""
    taken: int
    """Inputs of the source that it was made of, those that gave no entry too."""
    prior: str | None = None
    """Fingerprint of the prior that betas are of; None: that of the catalogue."""

    @classmethod
    def of(cls, signatures: Sequence[Signature], entries: Sequence[Entry], taken: int, size: int) -> Self:
        """Of signatures of ``size`` numbers. Raises InputError where they are of several priors."""
        known = [signature.covariance for signature in signatures if signature.covariance is not None]
        betas = np.array([signature.beta for signature in signatures]).reshape(-1, size)
        covariances = np.sum(known, axis=0) if known else np.zeros((size, size))
        prior = prior_of(signatures) if signatures else None
        return cls(betas, with_hands(signatures, entries), covariances, taken, prior)

    @property
    def bytes(self) -> int:
        """Of its pictures."""
        return sum(len(entry.thumbnail) for entry in self.entries)


def write_part(folder: Path, name: str, portions: Sequence[Portion]) -> StoredPart:
    """Under a new ``name``; on the disk when it returns."""
    betas, blob, ends = (folder / f"{name}{suffix}" for suffix in (BETAS, BLOB, ENDS))
    np.save(betas, np.concatenate([portion.betas for portion in portions]).astype(np.float32))
    marks, hands = [], []
    with blob.open("wb") as file:
        for portion in portions:
            for entry in portion.entries:
                hands.append(UNKNOWN if entry.of_other_hand is None else int(entry.of_other_hand))
                # names of files may be no UTF-8
                texts = [text.encode(errors="backslashreplace") for text in (entry.name, entry.source)]
                for field in (*texts, entry.thumbnail):
                    file.write(field)
                    marks.append(file.tell())
    table = np.array(marks, dtype=np.int64).reshape(-1, 3)
    np.save(ends, table if set(hands) == {UNKNOWN} else np.column_stack([table, hands]))
    for path in (betas, blob, ends):
        to_disk(path)
    return StoredPart(name, len(hands), (betas.stat().st_size, blob.stat().st_size, ends.stat().st_size))


class PartReader:
    """A part where it lies. Raises InputError where its files are not what was written."""

    def __init__(self, folder: Path, stored: StoredPart, size: int) -> None:
        paths = [folder / f"{stored.name}{suffix}" for suffix in (BETAS, BLOB, ENDS)]
        for path, length in zip(paths, stored.sizes, strict=True):
            if not is_file(path) or path.stat().st_size != length:
                raise InputError(f"{path}: missing or cut short; {CURE}")
        self._paths, self._entries, self._written = paths, stored.entries, paths[2].stat().st_mtime_ns
        betas, _, ends = self._maps()
        if betas.shape != (stored.entries, size) or ends.shape not in [(stored.entries, 3), (stored.entries, 4)]:
            raise InputError(f"{paths[0]}: is of another catalogue; {CURE}")

    def __len__(self) -> int:
        return self._entries

    def _maps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return _mapped(*self._paths, self._written)

    @property
    def betas(self) -> np.ndarray:
        """(n, D)."""
        return self._maps()[0]

    def entry(self, row: int) -> Entry:
        """Raises InputError where it is damaged."""
        _, blob, table = self._maps()
        begin = int(table[row - 1, 2]) if row else 0
        *ends, hand = [*table[row].tolist(), UNKNOWN][:4]
        marks = [begin, *ends]
        if sorted(marks) != marks or not 0 <= marks[0] <= marks[-1] <= len(blob):
            raise InputError(f"entry {row}: is damaged; {CURE}")
        name, source, thumbnail = (blob[low:high].tobytes() for low, high in zip(marks, marks[1:], strict=False))
        of_other_hand = None if hand == UNKNOWN else hand > 0
        return Entry(name.decode(errors="replace"), source.decode(errors="replace"), thumbnail, of_other_hand)


@lru_cache(maxsize=MAPPED)
def _mapped(betas: Path, blob: Path, ends: Path, _written: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A part's betas, texts and pictures, and table of ends. Not of all parts at once: each map holds a file open, and
    catalogues may have more parts than a process may have open files."""
    bytes_of_all = np.memmap(blob, np.uint8, "r") if blob.stat().st_size else np.zeros(0, np.uint8)
    return map_array(betas), bytes_of_all, map_array(ends)
