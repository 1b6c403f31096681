"""The program that ``omad deploy`` wrote, beside the library: how near its answers are, its size, and how long a fresh
process takes until it has answered.

    omad deploy --category laptop --output deployed
    OMP_NUM_THREADS=1 python benchmarks/speed/bench_deployed.py deployed [--views 100] [--json]

Answers are compared on noisy views of objects that no training has seen. Times are of one thread: on the processor,
as other programs may compute, and on the clock; of fresh processes the least of ``--starts``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

import omad
from omad.applications.deployment.program import Program
from omad.data.source import load_views

LIBRARY = """
import sys, numpy, omad
estimator = omad.Estimator.from_pretrained(sys.argv[1], "cpu")
estimator(omad.Observation.from_points(numpy.load(sys.argv[2])))
"""


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    folder: Annotated[Path, tyro.conf.Positional]
    views: int = 100
    starts: int = 5
    json: bool = False


def main(config: Config) -> None:
    program = Program(config.folder)
    estimator = omad.Estimator.from_pretrained(program.numbers["category"], "cpu")
    source = load_views("procedural", estimator.category, 20, config.views, 0, "on", "refuse")
    clouds = [view.observation() for view in source.views]
    apart, seconds = [], {"program": [], "library": []}
    for cloud in clouds:
        truth, _, spent = timed(lambda cloud=cloud: estimator(cloud))
        seconds["library"].append(spent)
        found, _, spent = timed(lambda cloud=cloud: program(cloud.points))
        seconds["program"].append(spent)
        apart.append([off(found.joint_states, truth.joint_states), off(found.keypoints, truth.keypoints)])
    with tempfile.TemporaryDirectory() as folder:
        cloud = Path(folder) / "cloud.npy"
        np.save(cloud, clouds[0].points)
        commands = {
            "program": [str(config.folder / "estimate.py"), str(cloud)],
            "library": ["-c", LIBRARY, str(program.numbers["category"]), str(cloud)],
        }
        starts = {name: [started(words) for _ in range(config.starts)] for name, words in commands.items()}
    answer: dict[str, Any] = {
        "views": len(clouds),
        # 95 % of the views, and all
        "difference_state": np.quantile([a for a, _ in apart], [0.95, 1]).tolist(),
        "difference_keypoints_m": np.quantile([b for _, b in apart], [0.95, 1]).tolist(),
        "bytes": sum(path.stat().st_size for path in config.folder.iterdir() if path.is_file()),
    }
    for name in commands:
        answer[f"{name}_ms_an_answer_processor"] = 1e3 * float(np.median(seconds[name]))
        answer[f"{name}_start_to_answer_seconds"] = min(wall for wall, _ in starts[name])
        answer[f"{name}_start_to_answer_processor_seconds"] = min(spent for _, spent in starts[name])
    print(json.dumps(answer) if config.json else "\n".join(f"{key}: {value}" for key, value in answer.items()))


def off(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.abs(found - truth).max())


def timed(work: Callable[[], Any]) -> tuple[Any, float, float]:
    """What it gives, and seconds on the clock and on the processor."""
    began, used = time.perf_counter(), time.process_time()
    found = work()
    return found, time.perf_counter() - began, time.process_time() - used


def started(words: list[str]) -> tuple[float, float]:
    """Seconds of a fresh process from its start to its end, on the clock and on the processor."""
    before, began = os.times(), time.perf_counter()
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - began, used


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
