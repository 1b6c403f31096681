"""What does the shards: processes of this machine, or Ray Data on a cluster."""

import contextlib
import importlib.util
import logging
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any

import torch

from omad.common.errors import WorkError
from omad.common.files import one_line
from omad.common.processes.workers import helpers
from omad.data.shards.parquet import part_name

from .shards import Done, Engine, Plan

TRIES = 4
"""Of a shard that fails, as where a disk or a network does not answer for a moment; and of processes that are killed
one after the other."""
PAUSE = 0.5
"""Seconds before another try, and twice as many before the next."""


def choose_engine(workers: int, gpus: float = 0.0) -> Engine:
    """Ray Data where it is installed, else ``workers`` processes. ``gpus``: of a task's, on a cluster."""
    if importlib.util.find_spec("ray") is None:
        return partial(_without_ray, workers=workers)
    return partial(on_cluster, gpus=gpus)


def _without_ray(plan: Plan, numbers: list[int], workers: int) -> Iterator[Done]:
    what = "processes of this machine are used, as Ray is not installed (pip install 'omad[cluster]')"
    print(f"omad: {what}", file=sys.stderr)
    yield from in_processes(plan, numbers, workers)


def in_processes(plan: Plan, numbers: list[int], workers: int) -> Iterator[Done]:
    """In processes of this machine; where one is killed, others do what it was at. Raises WorkError where that happens
    again and again."""
    left, killed = set(numbers), 0
    while left:
        pool = helpers(min(workers, len(left)), _begin, plan)
        try:
            for ended in as_completed([pool.submit(_make, number) for number in sorted(left)]):
                done, killed = ended.result(), 0
                left.remove(done.number)
                yield done
        except BrokenProcessPool as error:
            killed += 1
            if killed == TRIES:
                what = "processes of this machine are killed again and again; is there too little memory?"
                raise WorkError(what) from error
        finally:
            pool.shutdown(cancel_futures=True)


_plan: Plan
"""In a worker process, what it works on."""


def _begin(plan: Plan) -> None:
    global _plan
    _plan = plan
    torch.set_num_threads(1)


def _make(number: int) -> Done:
    return persistent(_plan, number)


def on_cluster(plan: Plan, numbers: list[int], gpus: float = 0.0) -> Iterator[Done]:
    """On the Ray cluster that ``RAY_ADDRESS`` names, else on all cores of this machine. What a lost machine was at is
    done by others. Raises WorkError where there is none, or it gives up."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray  # pyright: ignore[reportMissingImports]
    import ray.data  # pyright: ignore[reportMissingImports]
    import ray.exceptions  # pyright: ignore[reportMissingImports]

    begun = not ray.is_initialized()
    with contextlib.redirect_stdout(sys.stderr):  # Ray tells there of lost machines; stdout is for the answer
        if begun:
            try:
                ray.init(logging_level=logging.ERROR, log_to_driver=False)
            except Exception as error:  # of an address where none is, or a machine too busy to begin
                what = f"no cluster can be reached or started ({one_line(error)[:300]})"
                raise WorkError(f"{what}; see RAY_ADDRESS, and run it again") from error
        logging.getLogger("ray.data").setLevel(logging.ERROR)
        ray.data.DataContext.get_current().enable_progress_bars = False
        try:
            shards = ray.data.from_items(numbers, override_num_blocks=len(numbers))
            for row in shards.map(partial(_told, plan), num_cpus=1, num_gpus=gpus or None).iter_rows():
                yield Done(**row)
        except ray.exceptions.RayError as error:
            raise WorkError(f"the cluster gave up ({one_line(error)[:300]}); run it again") from error
        finally:
            if begun:
                ray.shutdown()


def _told(plan: Plan, row: dict[str, int]) -> dict[str, Any]:
    torch.set_num_threads(1)
    return vars(persistent(plan, row["item"]))


def persistent(plan: Plan, number: int) -> Done:
    """A shard, tried again where what failed may not fail the next time."""
    for pause in (PAUSE * 2**i for i in range(TRIES - 1)):
        try:
            return plan(number)
        except Exception:
            time.sleep(pause)
    try:
        return plan(number)
    except Exception as error:
        return Done(number, 0, error=f"{part_name(number)}: {type(error).__name__}: {one_line(error)}")
