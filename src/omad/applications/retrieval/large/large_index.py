"""A catalogue in a folder, for more entries than memory holds: made of a stream, added to, and asked where it lies."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import accumulate
from pathlib import Path
from typing import Self

import numpy as np

from omad.common.errors import InputError
from omad.common.files import TEMPORARY, make_folder
from omad.common.incoming import read_arrays
from omad.common.processes.locks import only_one

from ..index import Entry, Hit, ShapeIndex, hit_of, nearest_objects, whole
from ..search import Neighbours, faiss
from ..signature import Signature, Space, information_factor
from . import lists as ivf
from .manifest import (
    CURE,
    FILE,
    Manifest,
    StoredLists,
    digest_of_names,
    publish_manifest,
    read_manifest,
    to_disk,
)
from .parts import PartReader, Portion, write_part

PART_ENTRIES, PART_BYTES, PART_SECONDS = 2**18, 2**27, 60.0
"""When what came in is written: so much is in memory, and so much is made again after a kill."""
GROWTH = 8
"""Times more entries than the lists' centres were chosen for call for new ones."""
ROUNDED = 1e-4
"""By how much sums of betas differ that were estimated anew, in other batches say, at most."""
WRITER = "another command"
"""Who may be at it."""
BLOCK = 4096
"""Entries of another catalogue in memory at a time."""
RANKED_AGAIN = 1000
"""Nearest entries of which the search by information finds the nearest."""

Digest = Callable[[int], str]
"""Tells so many first inputs of a source from others."""


class LargeIndex:
    """As ``ShapeIndex``, on disk. Several processes may ask it while one adds to it.

    index = LargeIndex.create(folder, Space.of(net.prior, net.category))
    index.add(portions)
    hits = LargeIndex.open(folder).search(signature, count=5)
    """

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        self.folder = folder
        self._show(manifest)

    @classmethod
    def open(cls, folder: str | Path) -> Self:
        """Raises InputError for what is no catalogue, or is damaged."""
        folder = Path(folder)
        manifest = read_manifest(folder)
        while True:
            try:
                return cls(folder, manifest)
            except InputError:
                before, manifest = manifest, read_manifest(folder)
                if manifest == before:  # else another process made larger lists of those
                    raise

    @classmethod
    def create(cls, folder: str | Path, space: Space) -> Self:
        """An empty one, or the one that is there. Raises InputError where that is of another space."""
        folder = Path(folder)
        if (folder / FILE).exists():
            found = cls.open(folder)
            if (found.space.prior, found.space.metric) != (space.prior, space.metric):
                said = f"is a catalogue of prior {found.space.prior} and metric {found.space.metric}"
                raise InputError(f"{folder}: {said}; choose another folder, or the same weights and --metric")
            return found
        if not hasattr(faiss(), "OnDiskInvertedLists"):
            raise InputError(f"{folder}: FAISS has no lists on disk here, as on Windows; use --backend exact or faiss")
        make_folder(folder)
        with only_one(folder, WRITER):
            there = {path.name for path in folder.iterdir() if not path.name.startswith(TEMPORARY)}
            if FILE not in there:
                if there:
                    raise InputError(f"{folder}: is not empty, and no catalogue; choose another folder")
                factor = tuple(map(tuple, space.factor.tolist()))
                nothing = tuple(map(tuple, np.zeros_like(space.factor).tolist()))
                publish_manifest(folder, Manifest(space.prior, space.category, space.metric, factor, nothing))
        return cls.create(folder, space)

    def _show(self, manifest: Manifest) -> None:
        size = len(manifest.factor)
        self.manifest = manifest
        self.space = Space(manifest.prior, manifest.category, manifest.metric, np.array(manifest.factor))
        self._parts = [PartReader(self.folder, part, size) for part in manifest.parts]
        *self._starts, self._entries = accumulate((part.entries for part in manifest.parts), initial=0)
        centres = self._centres(manifest)
        self._search = None if centres is None else ivf.ListSearch(self.folder, centres, manifest.lists)

    def __len__(self) -> int:
        return self._entries

    @property
    def usual_covariance(self) -> np.ndarray:
        """(D, D) mean of the entries'."""
        return np.array(self.manifest.covariances) / max(len(self), 1)

    def taken(self, source: str) -> int:
        """How many inputs of a source are in."""
        return dict(self.manifest.taken).get(source, 0)

    def entry(self, row: int) -> Entry:
        """What is said of one."""
        part = int(np.searchsorted(self._starts, row, side="right")) - 1
        return self._parts[part].entry(row - self._starts[part])

    def betas_of(self, rows: np.ndarray) -> np.ndarray:
        """(n, D) of rows (n,)."""
        parts = np.searchsorted(self._starts, rows, side="right") - 1
        found = [self._parts[p].betas[row - self._starts[p]] for p, row in zip(parts, rows, strict=True)]
        return np.array(found).reshape(-1, len(self.space.factor))

    def search(self, signature: Signature, count: int = 10, by_information: bool = False) -> list[Hit]:
        """As ``ShapeIndex.search``, nearly always; ``by_information`` among the ``RANKED_AGAIN`` nearest."""
        self.space.check(signature)
        count = whole(count)
        if by_information and signature.covariance is None:
            raise InputError("the query's covariance is not known; leave out the weighting by information")
        asked = max(count, RANKED_AGAIN) if by_information else count
        found = self.nearest(signature.beta[None], asked)
        rows, distances = found.rows[0], found.distances[0]
        rows, distances = rows[rows >= 0], distances[rows >= 0]
        if by_information and signature.covariance is not None:
            factor = information_factor(signature.covariance, self.usual_covariance)
            distances = np.linalg.norm((self.betas_of(rows) - signature.beta) @ factor.T, axis=1)
            best = np.argsort(distances, kind="stable")[:count]
            rows, distances = rows[best], distances[best]
        pairs = zip(rows.tolist(), distances.tolist(), strict=True)
        return [hit_of(self.entry(row), off, signature) for row, off in pairs]

    def search_objects(self, signature: Signature, count: int = 10, by_information: bool = False) -> list[Hit]:
        """As ``ShapeIndex.search_objects``."""
        return nearest_objects(lambda asked: self.search(signature, asked, by_information), count, len(self))

    def nearest(self, betas: np.ndarray, count: int) -> Neighbours:
        """Rows and distances of the nearest entries of queries (Q, D)."""
        count = min(count, len(self))
        if not count or self._search is None:
            return Neighbours(np.zeros((len(betas), 0), dtype=np.int64), np.zeros((len(betas), 0)))
        found = self._search.nearest(self.space.vectors(betas), count)
        if found.rows.max() >= len(self):
            raise InputError(f"{self.folder}: is damaged (its lists name entries that are not there); build it anew")
        return found

    def add(self, portions: Iterable[Portion], source: str = "", inputs: Sequence[str] = (), options: str = "") -> None:
        """Add a stream of entries; what is not yet written is in memory, at most some hundred thousand of them. After
        a kill all that was written is there, and ``taken`` tells how many inputs of ``source`` need not come again.
        ``inputs``: names of all of them, where they have any; ``options``: how they are read. Raises InputError where
        another process adds, for entries of another prior, and where the first ``inputs`` or the ``options`` are not
        those that are in."""
        read = (options,) if options else ()
        digest = (lambda count: digest_of_names([*read, *inputs[:count]])) if read or inputs else None
        self._add(portions, source, digest)

    def _add(self, portions: Iterable[Portion], source: str, digest: Digest | None) -> None:
        with only_one(self.folder, WRITER):
            self._show(read_manifest(self.folder))
            self._check_inputs(source, digest)
            for some in _gathered(portions):
                self._add_part(some, source, digest)

    def merge(self, other: ShapeIndex | LargeIndex, source: str) -> None:
        """Add the entries of another catalogue, called ``source``, but for those that are in. Raises InputError where
        it is of another space, where its first entries are not those that are in, and for the catalogue itself."""
        self.space.check_same(other.space, source, self.folder)
        if isinstance(other, LargeIndex) and other.folder.resolve() == self.folder.resolve():
            raise InputError(f"{source}: is the catalogue itself; give another one")

        def coming() -> Iterator[Portion]:
            yield from _portions_of(other, self.taken(source))  # asked for when nobody else writes any more

        self._add(coming(), source, _DigestOfEntries(other))

    def _check_inputs(self, source: str, digest: Digest | None) -> None:
        known, taken = dict(self.manifest.names).get(source), self.taken(source)
        if digest is not None and known is not None and not _same(known, digest(taken)):
            cure = "put new ones into a folder of their own, give the same options, or build it anew"
            said = f"its first {taken} inputs are not those that are in {self.folder}, or read with other options"
            raise InputError(f"{source}: {said}; {cure}")

    def _add_part(self, portions: list[Portion], source: str, digest: Digest | None) -> None:
        manifest, size = self.manifest, len(self.space.factor)
        for portion in portions:
            self.space.check_prior(portion.prior or self.space.prior)
            if portion.betas.shape != (len(portion.entries), size) or not np.isfinite(portion.betas).all():
                raise InputError(f"betas: expected finite ({len(portion.entries)}, {size}), got {portion.betas.shape}")
        covariances = np.array(manifest.covariances) + sum(portion.covariances for portion in portions)
        count = self.taken(source) + sum(portion.taken for portion in portions)
        taken = dict(manifest.taken) | {source: count}
        names = dict(manifest.names) | ({} if digest is None else {source: digest(count)})
        manifest = replace(
            manifest,
            covariances=tuple(map(tuple, covariances.tolist())),
            taken=tuple(sorted(taken.items())),
            names=tuple(sorted(names.items())),
        )
        if not any(len(portion.entries) for portion in portions):
            self._show(manifest)  # not published: inputs that were all refused are read again another time
            return
        part = write_part(self.folder, f"part-{manifest.number + 1:06d}", portions)
        manifest = replace(manifest, number=manifest.number + 1, parts=(*manifest.parts, part))
        self._starts.append(len(self))
        self._parts.append(PartReader(self.folder, part, size))
        if manifest.entries > GROWTH * manifest.centres_for:
            manifest = self._with_new_centres(manifest)
        else:
            manifest = self._with_lists_of(manifest, len(manifest.parts) - 1)
        publish_manifest(self.folder, manifest)
        self._show(manifest)

    def _with_new_centres(self, manifest: Manifest) -> Manifest:
        """All lists made anew, about as many as the entries want."""
        count, rng = ivf.centres_for(manifest.entries), np.random.default_rng(manifest.entries)
        share = min(1.0, ivf.LEARNT_FROM * count / manifest.entries)
        sample = []
        for part in self._parts:
            rows = np.sort(rng.choice(len(part), max(1, round(share * len(part))), replace=False))
            sample.append(self.space.vectors(part.betas[rows]))
        name = f"centres-{manifest.number + 1:06d}"
        manifest = replace(manifest, number=manifest.number + 1, centres=name, centres_for=manifest.entries, lists=())
        path = self.folder / f"{name}.npy"
        np.save(path, ivf.learn_centres(np.concatenate(sample), count))
        to_disk(path)
        each = []
        for index in range(len(self._parts)):
            manifest, stored = self._written(manifest, [self._sorted(manifest, index)])
            each.append(stored)
        if len(each) > 1:
            size = len(self.space.factor)
            lists = [ivf.stored_lists(self.folder, stored, size) for stored in each]
            manifest, stored = self._written(manifest, lists)
        return replace(manifest, lists=(stored,))

    def _with_lists_of(self, manifest: Manifest, index: int) -> Manifest:
        """With lists of the part ``index``. Lists of no more entries than those to come are joined with them, so that
        there are never many."""
        joined, entries, kept = [self._sorted(manifest, index)], len(self._parts[index]), list(manifest.lists)
        while kept and kept[-1].entries <= entries:
            joined.insert(0, ivf.stored_lists(self.folder, kept[-1], len(self.space.factor)))
            entries += kept.pop().entries
        manifest, stored = self._written(manifest, joined)
        return replace(manifest, lists=(*kept, stored))

    def _sorted(self, manifest: Manifest, index: int) -> ivf.Lists:
        centres = self._centres(manifest)
        assert centres is not None
        return ivf.sorted_into_lists(centres, self.space.vectors(self._parts[index].betas), self._starts[index])

    def _written(self, manifest: Manifest, lists: list[ivf.Lists]) -> tuple[Manifest, StoredLists]:
        stored = ivf.write_lists(self.folder, f"lists-{manifest.number + 1:06d}", lists)
        return replace(manifest, number=manifest.number + 1), stored

    def _centres(self, manifest: Manifest) -> np.ndarray | None:
        """(L, D) of its lists; None where it has no entries."""
        if manifest.centres is None:
            return None
        path = self.folder / f"{manifest.centres}.npy"
        found = read_arrays(path, "centres of a catalogue", CURE)
        if not isinstance(found, np.ndarray) or found.ndim != 2 or found.shape[1] != len(manifest.factor):
            raise InputError(f"{path}: is of another catalogue; {CURE}")
        return found


def open_index(path: str | Path) -> ShapeIndex | LargeIndex:
    """A catalogue of either kind: a file, or a folder. Raises InputError."""
    return LargeIndex.open(path) if Path(path).is_dir() else ShapeIndex.load(path)


def _portions_of(index: ShapeIndex | LargeIndex, first: int) -> Iterator[Portion]:
    """Its entries from the row ``first`` on; of their covariances only the mean is known."""
    for rows in _blocks(first, len(index)):
        yield Portion(_betas_of(index, rows), _entries_of(index, rows), index.usual_covariance * len(rows), len(rows))


class _DigestOfEntries:
    """Of what a catalogue's first so many entries are called, and behind it sums of their betas, as these are rounded
    otherwise where they were estimated anew; for numbers that grow."""

    def __init__(self, index: ShapeIndex | LargeIndex) -> None:
        self._index, self._names, self._done = index, sha256(), 0
        self._sums = np.zeros(len(index.space.factor))

    def __call__(self, count: int) -> str:
        index = self._index
        for rows in _blocks(self._done, min(count, len(index))):
            self._sums += np.cos(rows) @ _betas_of(index, rows)  # no two rows count alike
            for entry in _entries_of(index, rows):
                self._names.update(f"{entry.name}\0{entry.source}\0".encode(errors="surrogateescape"))
        self._done = count
        numbers = (f"{value:.6f}" for value in self._sums / max(count, 1) ** 0.5)
        return " ".join([self._names.hexdigest()[:32], *numbers])


def _same(known: str, digest: str) -> bool:
    before, now = known.partition(" "), digest.partition(" ")
    sums = [np.fromstring(numbers, sep=" ") for *_, numbers in (before, now)]
    return before[0] == now[0] and len(sums[0]) == len(sums[1]) and np.allclose(*sums, rtol=0, atol=ROUNDED)


def _betas_of(index: ShapeIndex | LargeIndex, rows: np.ndarray) -> np.ndarray:
    return index.betas_of(rows) if isinstance(index, LargeIndex) else index.betas[rows]


def _entries_of(index: ShapeIndex | LargeIndex, rows: np.ndarray) -> list[Entry]:
    return [index.entry(row) if isinstance(index, LargeIndex) else index.entries[row] for row in rows.tolist()]


def _blocks(first: int, end: int) -> Iterator[np.ndarray]:
    for start in range(first, end, BLOCK):
        yield np.arange(start, min(start + BLOCK, end))


def _gathered(portions: Iterable[Portion]) -> Iterator[list[Portion]]:
    """As many together as make a part."""
    some: list[Portion] = []
    began = time.monotonic()
    for portion in portions:
        some.append(portion)
        full = sum(len(p.entries) for p in some) >= PART_ENTRIES or sum(p.bytes for p in some) >= PART_BYTES
        if full or time.monotonic() - began > PART_SECONDS:
            yield some
            some, began = [], time.monotonic()
    if some:
        yield some
