"""A catalogue on disk for as many entries as asked for: made of a stream, then asked; recall against the exact search.

    OMP_NUM_THREADS=1 python benchmarks/speed/bench_large_index.py [--entries 1000000] [--category laptop] [--json]

Entries are drawn as shapes of the category vary (the prior's mean and covariance of beta), every one another object;
queries are entries with an estimator's error added. Building and asking are processes of their own, so that their peaks
of memory can be told apart; what they take to begin, without a catalogue, is told too. ``--types`` compares kinds of
FAISS indices in memory instead, each with and without comparing its candidates again exactly.
"""

from __future__ import annotations

import json
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from omad.applications.retrieval.index import Entry
from omad.applications.retrieval.large.large_index import LargeIndex
from omad.applications.retrieval.large.parts import Portion
from omad.applications.retrieval.search import ExactSearch, faiss
from omad.applications.retrieval.signature import Space
from omad.model.checkpoint import find_weights, load
from omad.model.omadnet import OmadNet

BLOCK = 10_000
COUNT = 10
TYPES = ("IVF4096,Flat", "IVF4096,SQfp16", "IVF4096,PQ10x8", "HNSW32")


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    category: str = "laptop"
    entries: int = 1_000_000
    queries: int = 500
    noise: float = 0.3
    """Of a view, in standard deviations of beta."""
    types: bool = False
    """Compare kinds of indices."""
    json: bool = False


class Numbers:
    """Entries and queries, drawn anew whenever they are asked for."""

    def __init__(self, config: Config) -> None:
        net = load(OmadNet, find_weights(config.category))
        prior, self.config = net.prior, config
        self.mean = prior.beta_mean.double().numpy()
        self.spread = np.linalg.cholesky(prior.beta_covariance.double().numpy()).T
        self.space = Space.of(prior, net.category)

    def betas(self) -> Iterator[np.ndarray]:
        for start in range(0, self.config.entries, BLOCK):
            count = min(BLOCK, self.config.entries - start)
            drawn = np.random.default_rng((0, start)).standard_normal((count, len(self.mean)))
            yield (self.mean + drawn @ self.spread).astype(np.float32)

    def queries(self) -> np.ndarray:
        rng = np.random.default_rng(1)
        first = next(self.betas())
        chosen = first[rng.integers(len(first), size=self.config.queries)]
        return chosen + self.config.noise * rng.standard_normal(chosen.shape) @ self.spread

    def truth(self) -> np.ndarray:
        """(Q, COUNT) rows by the exact search."""
        vectors = np.concatenate([block @ self.space.factor.T for block in self.betas()])
        return ExactSearch(vectors).nearest(self.queries() @ self.space.factor.T, COUNT).rows

    def portions(self) -> Iterator[Portion]:
        size, row = len(self.mean), 0
        for block in self.betas():
            entries = [Entry(f"object-{row + i:09d}", "drawn at random") for i in range(len(block))]
            yield Portion(block, entries, np.zeros((size, size)), len(block))
            row += len(block)


def build(config: Config, folder: Path) -> dict[str, float]:
    numbers = Numbers(config)
    index, before, began, used = (
        LargeIndex.create(folder, numbers.space),
        peak(),
        time.perf_counter(),
        time.process_time(),
    )
    index.add(numbers.portions(), "numbers")
    disk = sum(path.stat().st_size for path in folder.iterdir())
    return {
        "build_seconds": time.perf_counter() - began,
        "build_processor_seconds": time.process_time() - used,
        "begin_mb": before,
        "build_peak_mb": peak(),
        "disk_bytes_an_entry": disk / config.entries,
    }


def ask(config: Config, folder: Path) -> dict[str, Any]:
    numbers = Numbers(config)
    queries, before, began = numbers.queries(), peak(), time.perf_counter()
    index = LargeIndex.open(folder)
    opened, wall, processor, rows = time.perf_counter() - began, [], [], []
    for query in queries:
        began, used = time.perf_counter(), time.process_time()
        found = index.nearest(query[None], COUNT)
        [index.entry(int(row)) for row in found.rows[0]]
        wall.append(time.perf_counter() - began)
        processor.append(time.process_time() - used)
        rows.append(found.rows[0])
    return {
        "open_seconds": opened,
        "query_ms": 1e3 * float(np.median(wall)),
        "query_processor_ms": 1e3 * float(np.median(processor)),
        "query_fastest_ms": 1e3 * min(wall),
        "ask_begin_mb": before,
        "ask_peak_mb": peak(),
        "centres": index.manifest.centres,
        "lists": [lists.entries for lists in index.manifest.lists],
        "rows": np.array(rows),
    }


def compare(config: Config) -> list[dict[str, Any]]:
    """Kinds of indices in memory: seconds to build, and by how many lists (or candidates) are looked at, recall and
    milliseconds a query, as they are and with four times as many candidates compared again."""
    library, numbers, truth, told = faiss(), Numbers(config), Numbers(config).truth(), []
    library.omp_set_num_threads(1)
    factor = numbers.space.factor
    vectors = np.concatenate([block @ factor.T for block in numbers.betas()]).astype(np.float32)
    queries = (numbers.queries() @ factor.T).astype(np.float32)
    for kind in TYPES:
        began, index = time.perf_counter(), library.index_factory(vectors.shape[1], kind)
        index.train(vectors[:: max(1, len(vectors) // 200_000)])
        index.add(vectors)
        built = time.perf_counter() - began
        for effort in (16, 32, 64) if "IVF" in kind else (64, 128):
            if "IVF" in kind:
                index.nprobe = effort
            else:
                index.hnsw.efSearch = effort
            row: dict[str, Any] = {"kind": kind, "build_seconds": built, "effort": effort}
            for name, count in (("", COUNT), ("_compared_again", 4 * COUNT)):
                began, found = time.perf_counter(), []
                for query in queries:
                    rows = index.search(query[None], count)[1][0]
                    found.append(rows[np.argsort(np.square(vectors[rows] - query).sum(1))[:COUNT]])
                row["query_ms" + name] = 1e3 * (time.perf_counter() - began) / len(queries)
                row["recall" + name] = recall(np.array(found), truth)
            told.append(row)
    return told


def recall(found: np.ndarray, truth: np.ndarray) -> float:
    """Share of the true rows (Q, k) that were found."""
    return float(np.mean([len(set(a) & set(b)) / len(b) for a, b in zip(found, truth, strict=True)]))


def peak() -> float:
    """MB that this process has had in memory at once; what it looked at of files is counted."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(config: Config) -> None:
    if config.types:
        for row in compare(config):
            print(json.dumps(row), flush=True)
        return
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        answer: dict[str, Any] = {"entries": config.entries, "queries": config.queries}
        for work in (build, ask):
            with spawn.Pool(1) as pool:
                answer |= pool.apply(work, (config, Path(name) / "index"))
    answer["recall_at_10"] = recall(answer.pop("rows"), Numbers(config).truth())
    print(json.dumps(answer) if config.json else "\n".join(f"{key}: {value}" for key, value in answer.items()))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
