"""``omad bulk``: many depth images, a row of numbers each."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import tyro
from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError
from omad.common.lazy import lazy_imports
from omad.sensing.input_options import FrameOptions, InputOptions

from ..answer import Answer
from ..options import CategoryCommand, Cluster, Fast, check_positive, check_workers, everywhere

with lazy_imports():
    from omad.applications.bulk.results import Results
    from omad.applications.bulk.sources import Source, open_sources
    from omad.applications.bulk.stream import Frame, estimate_stream
    from omad.applications.cluster.bulk import BulkWork
    from omad.common.batches import progress
    from omad.evaluation.paper.predictions import weights_identity
    from omad.model.checkpoint import find_weights

T = TypeVar("T", InputOptions, FrameOptions)
TOLD = 10
"""Refused images that are named on stderr."""


@dataclass(frozen=True, kw_only=True)
class Bulk(CategoryCommand):
    """Estimate very many depth images on all cores: one file of numbers, a row an image, in the order of the inputs.

    A run that was interrupted goes on where it was when it is given again. A bad image is a row that says why, and the
    exit code is then 2. Pictures, pages and URDFs are made by omad estimate.
    """

    inputs: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of depth images or clouds; stacks (N, H, W) as NPY or NPZ; Parquet files with a column depth, or their
    addresses."""
    output: Path
    """Results: .jsonl, a JSON object a line, or .parquet (pip install 'omad[parquet]')."""
    scale: OmitArgPrefixes[Cluster] = Cluster()
    reading: OmitArgPrefixes[InputOptions] = InputOptions()
    frame: OmitArgPrefixes[FrameOptions] = FrameOptions()
    fast: Fast = False
    workers: int = 0
    """Threads; 0: one a core."""
    batch: int = 16
    """Images that go through the network together."""

    def run(self) -> Answer:
        check_positive(depth_scale=self.reading.depth_scale, batch=self.batch)
        workers = check_workers(self.workers)
        source = open_sources(self.inputs, self.reading, self.frame)
        if self.scale.asked():
            return self._in_shards(source, workers)
        results = Results.open(self.output, self._made_of(source), self.batch)
        estimator, earlier, began = self.estimator(self.fast), results.done, time.perf_counter()
        found = estimate_stream(estimator, _rest(source, results), workers, self.batch)
        refused = 0
        for outcome in progress(results.add(found), source.total, "image", earlier, every=30.0):
            if outcome.refused is not None:
                refused += 1
                if refused <= TOLD:
                    more = "; further ones are named in the output alone" if refused == TOLD else ""
                    name = "" if outcome.refused.startswith(f"{outcome.name}: ") else f"{outcome.name}: "
                    print(f"omad: {name}{outcome.refused}{more}", file=sys.stderr)
        seconds = time.perf_counter() - began
        results.finish()
        record = {"output": str(self.output), "images": results.done, "refused": results.refused}
        record |= {"done_before": earlier, "seconds": seconds}
        record["images_per_second"] = (results.done - earlier) / seconds
        return Answer(record, code=2 if results.refused else 0)

    def _in_shards(self, source: Source, workers: int) -> Answer:
        weights = everywhere(self.weights) or self.category
        self.estimator(self.fast)  # what is wrong with weights is said here, not by every machine
        inputs = tuple(map(everywhere, self.inputs))
        if everywhere(self.output) in inputs:
            raise InputError(f"--output {self.output}: is one of the inputs; give a folder of its own")
        reading, frame = _everywhere(self.reading), _everywhere(self.frame)
        work = BulkWork(inputs, reading, frame, weights, self.device, self.fast, self.batch)
        done = self.scale.run(work, source.total, self.output, self._made_of(source), workers, self.device)
        return Answer(done.to_dict(), code=2 if done.report.refused else 0)

    def _made_of(self, source: Source) -> dict[str, Any]:
        """What rows depend on, as JSON gives it back."""
        options = {**asdict(self.reading), **asdict(self.frame)}
        told = {name: value if value is None else str(value) for name, value in options.items()}
        weights = weights_identity(find_weights(self.weights or self.category))
        own = {"category": self.category, "weights": weights, "fast": self.fast, "batch": self.batch}
        inputs = {"inputs": [str(everywhere(path)) for path in self.inputs], "total": source.total}
        inputs |= {"files": source.fingerprint()}
        return {**inputs, "version": omad.__version__, **own, **told}


def _rest(source: Source, results: Results) -> Iterator[Frame]:
    """The frames that are yet to do. Raises InputError where those that are done were others."""
    if results.done == 0:
        return source.after(0)
    frames = source.after(results.done - 1)
    if next(frames).name != results.last:
        raise InputError(f"{results.part}: the inputs have changed; delete it, or give another --output")
    return frames


def _everywhere(options: T) -> T:
    """The same with their paths as other processes find them."""
    return replace(options, **{name: everywhere(value) for name, value in vars(options).items()})
