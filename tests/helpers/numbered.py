"""Catalogue entries by number, and a catalogue of them that grows slowly, which other processes can import."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from omad.applications.retrieval.index import Entry
from omad.applications.retrieval.large import large_index
from omad.applications.retrieval.large.parts import Portion
from omad.applications.retrieval.signature import Space
from omad.model.prior import OmadPrior

from .categories import LAPTOP

SIZE = LAPTOP.basis_size
SPACE = Space.of(OmadPrior(LAPTOP, generator=torch.Generator().manual_seed(0)), LAPTOP, "beta")


def entries(first: int, last: int) -> list[Entry]:
    return [Entry(f"object {i // 2}", f"fïle {i}", bytes([i % 256]) * (i % 3)) for i in range(first, last)]


def betas(count: int) -> np.ndarray:
    return np.random.default_rng(0).standard_normal((count, SIZE)).astype(np.float32)


def stream(count: int, first: int = 0, each: int = 100) -> Iterator[Portion]:
    for start in range(first, count, each):
        stop = min(start + each, count)
        yield Portion(betas(count)[start:stop], entries(start, stop), 2 * (stop - start) * np.eye(SIZE), stop - start)


def add_slowly(folder: Path) -> None:
    """Twenty thousand in small parts, so that it is not done before it was killed six times."""
    large_index.PART_ENTRIES = 500
    index = large_index.LargeIndex.create(folder, SPACE)

    def paced() -> Iterator[Portion]:
        for portion in stream(20000, index.taken("numbers")):
            time.sleep(0.015)
            yield portion

    index.add(paced(), "numbers")
