"""Nearest neighbours from FAISS's graph of neighbours (HNSW): nearly always the nearest, in a fraction of the time.

FAISS is an extra (``pip install 'omad[faiss]'``); nothing else needs it.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from ..errors import InputError
from .search import Neighbours

LINKS = 32
"""Of every vector in the graph."""
BUILD_EFFORT = 80
"""Candidates that are looked at for the links of a new vector."""
SEARCH_EFFORT = 128
"""Candidates that a search keeps; more of them find more of the nearest."""


class GraphSearch:
    """Searches (N, D) vectors along a graph. Raises InputError where FAISS is not installed."""

    def __init__(self, graph: Any) -> None:
        self.graph = graph
        self.graph.hnsw.efSearch = SEARCH_EFFORT

    @classmethod
    def of(cls, vectors: np.ndarray) -> GraphSearch:
        """Build the graph: some tens of seconds for a million vectors."""
        graph = _faiss().IndexHNSWFlat(vectors.shape[1], LINKS)
        graph.hnsw.efConstruction = BUILD_EFFORT
        graph.add(np.ascontiguousarray(vectors, dtype=np.float32))
        return cls(graph)

    @classmethod
    def from_bytes(cls, stored: np.ndarray) -> GraphSearch:
        """What ``to_bytes`` gave, (n,) uint8."""
        return cls(_faiss().deserialize_index(stored))

    def to_bytes(self) -> np.ndarray:
        """The graph with its vectors, (n,) uint8."""
        return _faiss().serialize_index(self.graph)

    def nearest(self, queries: np.ndarray, count: int) -> Neighbours:
        """As ``ExactSearch.nearest``, of nearly all queries."""
        self.graph.hnsw.efSearch = max(SEARCH_EFFORT, 2 * count)
        squared, rows = self.graph.search(np.ascontiguousarray(queries, dtype=np.float32), count)
        distances = np.sqrt(np.maximum(squared, 0).astype(np.float64))
        return Neighbours(rows.astype(np.int64), np.where(rows < 0, np.inf, distances))


def _faiss() -> Any:
    try:
        return import_module("faiss")
    except ImportError as error:
        raise InputError("FAISS is not installed: pip install 'omad[faiss]', or search exactly") from error
