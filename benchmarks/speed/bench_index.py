"""How long a large catalogue takes to build and to ask, exactly and approximately, and how often they agree.

    OMP_NUM_THREADS=2 python benchmarks/speed/bench_index.py [--entries 1000000] [--views 20] [--faiss] [--json]

Entries are drawn as shapes of the category vary (the prior's mean and covariance of beta); with ``--views``, so many of
them are views of the same object, with an estimator's error each. Queries are entries with such an error added. Times
are medians per query, one at a time and in a batch, on the clock and on the processor: where other programs compute,
only the latter says what the search itself takes. Both take OMP_NUM_THREADS threads.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from omad.applications.retrieval.index import Backend, Entry, ShapeIndex
from omad.applications.retrieval.search import Neighbours
from omad.applications.retrieval.signature import Space
from omad.model.checkpoint import find_weights, load
from omad.model.omadnet import OmadNet


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    category: str = "laptop"
    entries: int = 1_000_000
    queries: int = 200
    count: int = 10
    views: int = 1
    """Entries of the same object."""
    noise: float = 0.3
    """Of a view, in standard deviations of beta."""
    faiss: bool = False
    """Measure the approximate backend, too (needs the extra omad[faiss])."""
    json: bool = False


def main(config: Config) -> None:
    net = load(OmadNet, find_weights(config.category))
    prior, rng = net.prior, np.random.default_rng(0)
    mean, covariance = prior.beta_mean.double().numpy(), prior.beta_covariance.double().numpy()
    spread = np.linalg.cholesky(covariance).T

    def errors(count: int) -> np.ndarray:
        return config.noise * rng.standard_normal((count, len(mean))) @ spread

    objects = mean + rng.standard_normal((-(-config.entries // config.views), len(mean))) @ spread
    betas = np.repeat(objects, config.views, axis=0)[: config.entries]
    if config.views > 1:
        betas += errors(len(betas))
    betas = betas.astype(np.float32)
    queries = (betas[rng.integers(config.entries, size=config.queries)] + errors(config.queries)).astype(np.float32)

    space = Space.of(prior, net.category)
    exact = filled("exact", space, betas)
    truth = exact.nearest(queries, config.count)
    vectors, asked = ((part @ space.factor.T).astype(np.float64) for part in (betas, queries[:5]))
    plain = np.stack([np.linalg.norm(vectors - query, axis=1).argsort()[: config.count] for query in asked])
    answer: dict[str, Any] = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "entries": config.entries,
        "views_of_an_object": config.views,
        "numbers": len(mean),
        "queries": config.queries,
        "agrees_with_plain_search": float(recall(truth.rows[:5], plain)),
    }
    del exact
    backends: tuple[Backend, ...] = ("exact", "faiss") if config.faiss else ("exact",)
    for backend in backends:
        answer[backend] = measured(filled(backend, space, betas), queries, truth, config.count)
    print(json.dumps(answer) if config.json else "\n".join(f"{key}: {value}" for key, value in answer.items()))


def filled(backend: Backend, space: Space, betas: np.ndarray) -> ShapeIndex:
    index = ShapeIndex(space, backend)
    index.add_betas(betas, [Entry(f"object-{row:07d}") for row in range(len(betas))])
    return index


def measured(index: ShapeIndex, queries: np.ndarray, truth: Neighbours, count: int) -> dict[str, float]:
    """Build time and memory, times per query, recall, and the file, of one backend."""
    before, began = resident(), time.perf_counter()
    index.nearest(queries[:1], count)
    built, memory = time.perf_counter() - began, resident() - before
    wall, processor = [], []
    for query in queries:
        began, used = time.perf_counter(), time.process_time()
        index.nearest(query[None], count)
        wall.append(time.perf_counter() - began)
        processor.append(time.process_time() - used)
    began, used = time.perf_counter(), time.process_time()
    found = index.nearest(queries, count)
    batch = (time.perf_counter() - began, time.process_time() - used)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "index.npz"
        began = time.perf_counter()
        index.save(path)
        saved = time.perf_counter() - began
        began = time.perf_counter()
        ShapeIndex.load(path)
        loaded = time.perf_counter() - began
        size = path.stat().st_size
    return {
        "build_seconds": built,
        "memory_mb": memory,
        "query_ms": 1e3 * float(np.median(wall)),
        "query_processor_ms": 1e3 * float(np.median(processor)),
        "query_fastest_ms": 1e3 * min(wall),
        "batch_query_ms": 1e3 * batch[0] / len(queries),
        "batch_query_processor_ms": 1e3 * batch[1] / len(queries),
        "recall_at_count": recall(found.rows, truth.rows),
        "save_seconds": saved,
        "load_seconds": loaded,
        "file_mb": size / 2**20,
    }


def recall(found: np.ndarray, truth: np.ndarray) -> float:
    """Share of the true rows (Q, k) that were found."""
    return float(np.mean([len(set(a) & set(b)) / len(b) for a, b in zip(found, truth, strict=True)]))


def resident() -> float:
    """MB of this program in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
