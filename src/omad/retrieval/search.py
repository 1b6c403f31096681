"""Exact nearest neighbours by Euclidean distance, for up to millions of short vectors.

All vectors are compared: at ten numbers each, a million of them are 40 MB, which is read in milliseconds.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np

CHUNK = 8192
"""Vectors that are compared with all queries before the next are read: they stay in the processor's cache."""
FEW = 20_000
"""So few distances are sooner computed than a kernel is loaded."""
MANY = 256
"""Neighbours beyond which sorting is faster than keeping the best so far."""


@dataclass(frozen=True)
class Neighbours:
    """The nearest vectors of Q queries, nearest first; of equally near ones that which was added first."""

    rows: np.ndarray
    """(Q, k) int64; -1 where an approximate search found fewer."""
    distances: np.ndarray
    """(Q, k) float64; infinite beside a row of -1."""


class ExactSearch:
    """Compares queries (Q, D) with all vectors (N, D), on ``threads`` threads (default: a thread a core)."""

    def __init__(self, vectors: np.ndarray, threads: int | None = None) -> None:
        self.vectors = np.asarray(vectors, dtype=np.float32)
        self.threads = threads or os.cpu_count() or 1
        # a column of numbers at a time is what the processor's vector units take
        self.columns = np.ascontiguousarray(self.vectors.T)
        self.pool: ThreadPoolExecutor | None = None

    def nearest(self, queries: np.ndarray, count: int) -> Neighbours:
        """The ``count`` nearest vectors of every query, or all where there are fewer."""
        queries = np.ascontiguousarray(queries, dtype=np.float32)
        count = min(count, len(self.vectors))
        if count > MANY or len(queries) * len(self.vectors) <= FEW:
            return nearest_plainly(self.vectors, queries, count)
        bounds = np.linspace(0, len(self.vectors), self.threads + 1).astype(np.int64)
        spans = [(first, last) for first, last in zip(bounds[:-1], bounds[1:], strict=True) if last > first]
        if len(spans) == 1:
            found = [_scan(self.columns, queries, count, *spans[0])]
        else:
            self.pool = self.pool or ThreadPoolExecutor(self.threads)
            found = list(self.pool.map(lambda span: _scan(self.columns, queries, count, *span), spans))
        rows, squared = (np.concatenate(parts, 1) for parts in zip(*found, strict=True))
        best = np.argsort(squared, axis=1, kind="stable")[:, :count]  # spans are in the order of rows
        rows, squared = np.take_along_axis(rows, best, 1), np.take_along_axis(squared, best, 1)
        return Neighbours(rows, np.sqrt(squared.astype(np.float64)))


def nearest_plainly(vectors: np.ndarray, queries: np.ndarray, count: int) -> Neighbours:
    """What ``ExactSearch`` finds, by sorting every distance: the reference, and the way for small sets."""
    rows = np.empty((len(queries), count), dtype=np.int64)
    distances = np.empty((len(queries), count))
    for q, query in enumerate(queries):
        squared = np.zeros(len(vectors), dtype=np.float32)
        for d in range(vectors.shape[1]):
            squared += (vectors[:, d] - query[d]) ** 2
        rows[q] = np.argsort(squared, kind="stable")[:count]
        distances[q] = np.sqrt(squared[rows[q]].astype(np.float64))
    return Neighbours(rows, distances)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _add_squares(total: np.ndarray, column: np.ndarray, value: np.float32) -> None:
    """A loop so plain that it becomes vector instructions."""
    for i in range(len(column)):
        total[i] += (column[i] - value) * (column[i] - value)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _scan(columns: np.ndarray, queries: np.ndarray, count: int, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and squared distances (Q, count) of the nearest among the vectors from ``first`` to ``last``; a chunk of
    them at a time for all queries."""
    rows = np.full((len(queries), count), -1, dtype=np.int64)
    best = np.full((len(queries), count), np.inf, dtype=np.float32)
    squared = np.empty(CHUNK, dtype=np.float32)
    for start in range(first, last, CHUNK):
        size = min(CHUNK, last - start)
        for q in range(len(queries)):
            squared[:] = 0.0
            for d in range(columns.shape[0]):
                _add_squares(squared[:size], columns[d, start : start + size], queries[q, d])
            worst = best[q, count - 1]
            for i in range(size):
                if squared[i] < worst:
                    place = count - 1
                    while place > 0 and best[q, place - 1] > squared[i]:
                        best[q, place] = best[q, place - 1]
                        rows[q, place] = rows[q, place - 1]
                        place -= 1
                    best[q, place] = squared[i]
                    rows[q, place] = start + i
                    worst = best[q, count - 1]
    return rows, best
