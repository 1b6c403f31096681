"""How long a large catalogue takes to build and to ask, exactly and approximately, and how often they agree.

    OMP_NUM_THREADS=2 python benchmarks/bench_index.py [--entries 1000000] [--faiss] [--json]

Entries are drawn as shapes of the category vary (the prior's mean and covariance of beta); queries are entries with an
estimator's error added. Times are medians per query, one at a time and in a batch, on the clock and on the processor:
where other programs compute, only the latter says what the search itself takes.
"""

from __future__ import annotations

import json
import platform
import resource
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from omad.checkpoint import find_weights, load_net
from omad.retrieval.approximate import GraphSearch
from omad.retrieval.index import Backend, Entry, ShapeIndex
from omad.retrieval.search import ExactSearch, Neighbours, nearest_plainly
from omad.retrieval.signature import Space


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    category: str = "laptop"
    entries: int = 1_000_000
    queries: int = 200
    count: int = 10
    noise: float = 0.3
    """Of a query, in standard deviations of beta."""
    threads: int = 2
    """Of the exact search; FAISS takes OMP_NUM_THREADS."""
    faiss: bool = False
    """Measure the approximate backend, too (needs the extra omad[faiss])."""
    json: bool = False


def main(config: Config) -> None:
    net = load_net(find_weights(config.category))
    prior, rng = net.prior, np.random.default_rng(0)
    mean, covariance = prior.beta_mean.double().numpy(), prior.beta_covariance.double().numpy()
    spread = np.linalg.cholesky(covariance).T
    betas = (mean + rng.standard_normal((config.entries, len(mean))) @ spread).astype(np.float32)
    errors = config.noise * rng.standard_normal((config.queries, len(mean))) @ spread
    queries = betas[rng.integers(config.entries, size=config.queries)] + errors

    space = Space.of(prior, net.category)
    vectors = (betas @ space.factor.T).astype(np.float32)
    asked = (queries @ space.factor.T).astype(np.float32)
    truth = ExactSearch(vectors, config.threads).nearest(asked, config.count)
    plain = nearest_plainly(vectors, asked[:5], config.count)
    answer: dict[str, Any] = {
        "machine": platform.machine(),
        "entries": config.entries,
        "numbers": vectors.shape[1],
        "queries": config.queries,
        "agrees_with_plain_search": bool((plain.rows == truth.rows[:5]).all()),
    }
    backends: tuple[Backend, ...] = ("exact", "faiss") if config.faiss else ("exact",)
    for backend in backends:
        answer[backend] = measured(backend, betas, vectors, asked, truth, space, config)
    answer["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(answer) if config.json else "\n".join(f"{key}: {value}" for key, value in answer.items()))


def measured(
    backend: Backend,
    betas: np.ndarray,
    vectors: np.ndarray,
    asked: np.ndarray,
    truth: Neighbours,
    space: Space,
    config: Config,
) -> dict[str, float]:
    """Build time and memory, times per query, recall, and the file, of one backend."""
    began = time.perf_counter()
    search = GraphSearch.of(vectors) if backend == "faiss" else ExactSearch(vectors, config.threads)
    built = time.perf_counter() - began
    search.nearest(asked[:1], config.count)
    wall, processor = [], []
    for query in asked:
        began, used = time.perf_counter(), time.process_time()
        search.nearest(query[None], config.count)
        wall.append(time.perf_counter() - began)
        processor.append(time.process_time() - used)
    began, used = time.perf_counter(), time.process_time()
    found = search.nearest(asked, config.count)
    batch = (time.perf_counter() - began, time.process_time() - used)
    recall = np.mean([len(set(a) & set(b)) / config.count for a, b in zip(found.rows, truth.rows, strict=True)])
    stored = search.to_bytes().nbytes if isinstance(search, GraphSearch) else search.columns.nbytes
    del search

    index = ShapeIndex(space, backend)
    index.add_betas(betas, [Entry(f"object-{row:07d}") for row in range(len(betas))])
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
        "memory_mb": stored / 2**20,
        "query_ms": 1e3 * float(np.median(wall)),
        "query_processor_ms": 1e3 * float(np.median(processor)),
        "query_fastest_ms": 1e3 * min(wall),
        "batch_query_ms": 1e3 * batch[0] / len(asked),
        "batch_query_processor_ms": 1e3 * batch[1] / len(asked),
        "recall_at_count": float(recall),
        "save_seconds": saved,
        "load_seconds": loaded,
        "file_mb": size / 2**20,
    }


if __name__ == "__main__":
    main(tyro.cli(Config))
