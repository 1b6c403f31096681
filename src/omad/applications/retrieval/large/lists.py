"""Vectors on disk, sorted by the nearest of some thousand centres, as FAISS searches them (``IndexIVFFlat``).

A query looks at the lists of the ``PROBES`` nearest centres and compares all vectors there; nothing else is read. Short
as the vectors are, there is nothing to gain by product quantisation: ten numbers are forty bytes, its codes ten, and
what these lose has to be compared again. ``benchmarks/speed/bench_large_index.py`` has the figures.

L centres, vectors of D numbers. A file holds list by list the vectors (n, D), float32, then their rows (n,), int64; the
sizes of the lists stand in a file beside it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import map_array, readable

from ..search import Neighbours, faiss
from .manifest import CURE, StoredLists, to_disk

PROBES = 48
"""Lists that a query looks at."""
SIZES, DATA = ".sizes.npy", ".data"
LEARNT_FROM = 64
"""Vectors a centre that the centres are chosen from."""
MOST_CENTRES = 2**17


def centres_for(entries: int) -> int:
    """How many make a search quickest: it compares all of them, and the vectors of a few of their lists."""
    return int(np.clip(2 ** round(np.log2(4 * entries**0.5)), 1, min(MOST_CENTRES, max(entries // LEARNT_FROM, 1))))


def learn_centres(sample: np.ndarray, count: int) -> np.ndarray:
    """(count, D) for vectors like the ``sample`` (n, D)."""
    found = faiss().Kmeans(
        sample.shape[1], count, niter=10, max_points_per_centroid=LEARNT_FROM, min_points_per_centroid=1
    )
    found.train(np.ascontiguousarray(sample, dtype=np.float32))
    return found.centroids


@dataclass(frozen=True)
class Lists:
    """Of L centres."""

    sizes: np.ndarray
    """(L,)."""
    of: Callable[[int], tuple[bytes, bytes]]
    """Vectors and rows of one of them."""


def sorted_into_lists(centres: np.ndarray, vectors: np.ndarray, first: int) -> Lists:
    """Lists in memory of ``vectors`` (n, D), the rows from ``first`` on."""
    nearest = _quantiser(centres).search(np.ascontiguousarray(vectors, dtype=np.float32), 1)[1][:, 0]
    order = np.argsort(nearest, kind="stable")
    ends = np.cumsum(sizes := np.bincount(nearest, minlength=len(centres)))

    def of(which: int) -> tuple[bytes, bytes]:
        rows = order[ends[which] - sizes[which] : ends[which]]
        return vectors[rows].astype(np.float32).tobytes(), (first + rows).astype(np.int64).tobytes()

    return Lists(sizes, of)


def stored_lists(folder: Path, stored: StoredLists, size: int) -> Lists:
    """Lists of vectors of ``size`` numbers where they lie. Raises InputError where the files are not what was
    written."""
    sizes, data = map_array(folder / f"{stored.name}{SIZES}"), folder / f"{stored.name}{DATA}"
    with readable(data, "lists", CURE):
        content = np.memmap(data, np.uint8, "r")
    whole = len(content) == stored.entries * (4 * size + 8)
    if not (whole and sizes.ndim == 1 and sizes.dtype == np.int64 and (sizes >= 0).all()):
        raise InputError(f"{data}: cut short or damaged; {CURE}")
    if sizes.sum() != stored.entries:
        raise InputError(f"{data}: is of another catalogue; {CURE}")
    starts = np.cumsum(sizes) - sizes

    def of(which: int) -> tuple[bytes, bytes]:
        begin = int(starts[which]) * (4 * size + 8)
        middle, end = begin + int(sizes[which]) * 4 * size, begin + int(sizes[which]) * (4 * size + 8)
        return content[begin:middle].tobytes(), content[middle:end].tobytes()

    return Lists(np.array(sizes), of)


def write_lists(folder: Path, name: str, lists: Sequence[Lists]) -> StoredLists:
    """Several lists of the same centres made one, on disk when it returns, one list in memory at a time."""
    sizes, data = folder / f"{name}{SIZES}", folder / f"{name}{DATA}"
    total = np.sum([one.sizes for one in lists], axis=0, dtype=np.int64)
    np.save(sizes, total)
    with data.open("wb") as file:
        for which in np.flatnonzero(total).tolist():
            vectors, rows = zip(*(one.of(which) for one in lists), strict=True)
            file.writelines((*vectors, *rows))
    for path in (sizes, data):
        to_disk(path)
    return StoredLists(name, int(total.sum()))


class ListSearch:
    """Searches ``stored`` lists of the same ``centres`` (L, D) where they lie. Raises InputError where their files are
    not what was written, and where FAISS is not installed."""

    def __init__(self, folder: Path, centres: np.ndarray, stored: Sequence[StoredLists]) -> None:
        self._quantiser = _quantiser(centres)
        self._probes = min(PROBES, len(centres))
        self._indices = [self._index(folder, one, *centres.shape) for one in stored]

    def _index(self, folder: Path, stored: StoredLists, count: int, size: int) -> Any:
        library, data = faiss(), folder / f"{stored.name}{DATA}"
        sizes = stored_lists(folder, stored, size).sizes.astype(np.uint64)
        if len(sizes) != count:
            raise InputError(f"{data}: is of other centres; {CURE}")
        lists = library.OnDiskInvertedLists(count, 4 * size, str(data))
        lists.set_all_lists_sizes(library.swig_ptr(sizes))
        lists.read_only, lists.totsize = True, stored.entries * (4 * size + 8)
        # it would start threads for every query, which take longer than what they read ahead
        lists.prefetch_nthread = 0
        with readable(data, "lists", CURE):  # another process may have put larger ones in its place
            lists.do_mmap()
        index = library.IndexIVFFlat(self._quantiser, size, count)
        index.replace_invlists(lists, True)
        lists.this.disown()
        index.nprobe, index.ntotal, index.is_trained = self._probes, stored.entries, True
        return index

    def nearest(self, queries: np.ndarray, count: int) -> Neighbours:
        """Of Q queries (Q, D); rows of -1 where the lists that were looked at hold fewer."""
        queries = np.ascontiguousarray(queries, dtype=np.float32)
        apart, centres = self._quantiser.search(queries, self._probes)
        found = [index.search_preassigned(queries, count, centres, apart) for index in self._indices]
        squared, rows = (np.concatenate(arrays, axis=1) for arrays in zip(*found, strict=True))
        distances = np.where(rows < 0, np.inf, np.sqrt(np.maximum(squared.astype(np.float64), 0)))
        best = np.argsort(distances, axis=1, kind="stable")[:, :count]
        return Neighbours(np.take_along_axis(rows, best, 1), np.take_along_axis(distances, best, 1))


def _quantiser(centres: np.ndarray) -> Any:
    index = faiss().IndexFlatL2(centres.shape[1])
    index.add(np.ascontiguousarray(centres, dtype=np.float32))
    return index
