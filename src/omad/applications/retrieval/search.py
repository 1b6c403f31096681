"""Nearest neighbours by Euclidean distance, for up to millions of short vectors, and nearly exact ones for many more.

The exact search compares all vectors: at ten numbers each, a million of them are 40 MB, which a matrix product reads in
milliseconds. The other follows FAISS's graph of neighbours (HNSW): it finds nearly always the nearest, in a fraction of
the time. FAISS is an extra (``pip install 'omad[faiss]'``); nothing else needs it.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any, Self

import numpy as np

from omad.common.errors import InputError

QUERIES = 8
"""Compared at a time, so that their distances fit into memory."""
SAMPLE = 20_000
"""Vectors whose distances bound how far the nearest ones can be: what is farther is not sorted."""
ROUNDING = 1e-5
"""Of a squared distance from a matrix product of single precision, as a share of the squared lengths."""
LINKS = 32
"""Of every vector in the graph."""
BUILD_EFFORT = 80
"""Candidates that are looked at for the links of a new vector."""
SEARCH_EFFORT = 128
"""Candidates that a search keeps; more of them find more of the nearest."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The nearest vectors of Q queries, nearest first; of equally near ones that which was added first."""

    rows: np.ndarray
    """(Q, k) int64; -1 where an approximate search found fewer."""
    distances: np.ndarray
    """(Q, k) float64; infinite beside a row of -1."""


class ExactSearch:
    """Compares queries (Q, D) with all vectors (N, D)."""

    def __init__(self, vectors: np.ndarray) -> None:
        self.vectors = np.asarray(vectors, dtype=np.float32)
        squared = np.square(self.vectors).sum(1)
        self._longest = float(squared.max(initial=0.0))
        # (q, 1) . (v, -|v|^2 / 2) is greatest where |v - q|^2 is least: one product ranks all vectors
        self._columns = np.ascontiguousarray(np.vstack([self.vectors.T, -squared / 2]))

    def nearest(self, queries: np.ndarray, count: int) -> Neighbours:
        """The ``count`` nearest vectors of every query, or all where there are fewer."""
        queries, count = np.asarray(queries, dtype=np.float32), min(count, len(self.vectors))
        rows, distances = np.empty((len(queries), count), dtype=np.int64), np.empty((len(queries), count))
        asked = np.c_[queries, np.ones(len(queries), dtype=np.float32)]
        for start in range(0, len(queries), QUERIES):
            for index, score in enumerate(asked[start : start + QUERIES] @ self._columns, start):
                rows[index], distances[index] = self._sorted(queries[index], score, count)
        return Neighbours(rows, distances)

    def _sorted(self, query: np.ndarray, score: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows and distances of the nearest; only those that may be among them are compared number by number."""
        sample = score[:: max(1, len(score) // SAMPLE)]
        near = np.arange(len(score))
        if count < len(sample):
            slack = ROUNDING * (self._longest + float(query @ query))
            near = np.flatnonzero(score >= np.partition(sample, -count)[-count] - slack)
        distances = np.linalg.norm(self.vectors[near].astype(np.float64) - query, axis=1)
        best = np.argsort(distances, kind="stable")[:count]
        return near[best], distances[best]


@dataclass(frozen=True)
class GraphSearch:
    """Searches (N, D) vectors along a graph. Raises InputError where FAISS is not installed."""

    graph: Any

    @classmethod
    def of(cls, vectors: np.ndarray) -> Self:
        """Build the graph: some tens of seconds for a million vectors."""
        graph = faiss().IndexHNSWFlat(vectors.shape[1], LINKS)
        graph.hnsw.efConstruction = BUILD_EFFORT
        graph.add(np.ascontiguousarray(vectors, dtype=np.float32))
        return cls(graph)

    @classmethod
    def from_bytes(cls, stored: np.ndarray) -> Self:
        """What ``to_bytes`` gave, (n,) uint8."""
        return cls(faiss().deserialize_index(stored))

    def to_bytes(self) -> np.ndarray:
        """The graph with its vectors, (n,) uint8."""
        return faiss().serialize_index(self.graph)

    def nearest(self, queries: np.ndarray, count: int) -> Neighbours:
        """As ``ExactSearch.nearest``, of nearly all queries."""
        self.graph.hnsw.efSearch = max(SEARCH_EFFORT, 2 * count)
        squared, rows = self.graph.search(np.ascontiguousarray(queries, dtype=np.float32), count)
        distances = np.sqrt(np.maximum(squared, 0).astype(np.float64))
        return Neighbours(rows.astype(np.int64), np.where(rows < 0, np.inf, distances))


def faiss() -> Any:
    """The library. Raises InputError where it is not installed."""
    try:
        return import_module("faiss")
    except ImportError as error:
        raise InputError("FAISS is not installed: pip install 'omad[faiss]', or search exactly") from error
