"""How long everything takes, as multiples of what the arithmetic alone would, beside an earlier version.

    OMP_NUM_THREADS=1 python benchmarks/speed/bench_speed.py [--before ../omad-before/src] [--json]

The floor of an estimate is that of the matrix products in the network's four passes, at the best rate that a large
matrix product reaches in the same run. Versions and steps take turns, round by round, so that all of them meet the same
neighbours on the machine: minimum and median of the rounds. ``--before`` is the ``src`` of another checkout, made with
``git worktree add ../omad-before COMMIT``; only what users call is called, so that any version will do.
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

import numpy as np

PASSES = 4
TURNS = 3
"""Calls of a step, one after the other, as in a robot's loop, before the next step's turn."""
SIZE = 1024
"""Of the matrices that tell the machine's best rate."""


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    categories: tuple[str, ...] = ("laptop", "eyeglasses")
    before: Path | None = None
    """``src`` of an earlier version to take turns with."""
    rounds: int = 30
    views: int = 8
    """Depth images; each round takes another, and a batch has all of them, four times over."""
    training_steps: int = 40
    """Of each training, at least 40, as every twentieth is logged; 0 leaves training out."""
    json: bool = False


def main(config: Config) -> None:
    versions = {"now": Path(__file__).parents[2] / "src"}
    if config.before is not None:
        versions["before"] = config.before.resolve()
    answer = {}
    for category in config.categories:
        with tempfile.TemporaryDirectory() as folder:
            images = Path(folder) / "views.npz"
            _draw(category, config.views, images)
            workers = {name: _Worker(source, category, images) for name, source in versions.items()}
            times: dict[str, dict[str, list[float]]] = {name: {} for name in workers}
            for number in range(config.rounds + 1):
                for step in STEPS:
                    for name, worker in workers.items():
                        for turn in range(1 if step == "bulk" else TURNS):
                            for key, seconds in worker.ask(step, TURNS * number + turn).items():
                                times[name].setdefault(key, []).append(seconds)
            for worker in workers.values():
                worker.close()
            answer[category] = _summary(
                category,
                {
                    # without the first round, which warms up
                    name: {key: each[len(each) // (config.rounds + 1) :] for key, each in steps.items()}
                    for name, steps in times.items()
                },
            )
            if config.training_steps:
                answer[category] |= _training(versions, category, config.training_steps, Path(folder))
    print(json.dumps(answer) if config.json else "\n\n".join(_table(*item) for item in answer.items()))


def _gflop(category: str) -> float:
    """Multiplications and additions of the matrix products in a pass of a category's network over a cloud, 1e9."""
    import torch
    from torch.utils.flop_counter import FlopCounterMode

    import omad

    net = omad.Estimator.from_pretrained(category, device="cpu").net
    with FlopCounterMode(display=False) as counted, torch.no_grad():
        net(torch.rand(1, net.backbone.config.points, 3))
    return 1e-9 * counted.get_total_flops()


def _draw(category: str, views: int, path: Path) -> None:
    from omad.data.procedural import generate
    from omad.data.rendering.standard_views import standard_views
    from omad.objects.category_file import get_category

    spec = get_category(category)
    drawn = list(standard_views([generate(spec, i, "test") for i in range(views)], spec, views))
    depth = np.stack([view.depth for view in drawn])
    # a wall behind, so that a mask is needed, as with a camera
    np.savez(path, depth=np.where(depth > 0, depth, 3.0), mask=depth > 0, K=drawn[0].camera.K)


# ---- one version, in a process of its own ----


def _steps(category: str, path: Path) -> dict[str, Callable[[int], dict[str, float]]]:
    import torch

    import omad

    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    with np.load(path) as file:
        depth, mask, K = file["depth"], file["mask"], file["K"]
    estimator = omad.Estimator.from_pretrained(category, device="cpu")
    fast = omad.Estimator.from_pretrained(category, device="cpu", config=omad.EstimatorConfig(samples=(1, 1)))
    a, b, c = torch.rand(SIZE, SIZE), torch.rand(SIZE, SIZE), torch.empty(SIZE, SIZE)
    observe = omad.Observation.from_depth
    seen = [observe(image, K, mask=region) for image, region in zip(depth, mask, strict=True)]
    trackers = [omad.Tracker(estimator)]
    batch = 4 * list(range(len(depth)))

    def timed(name: str, run: Callable[[], object], count: int = 1) -> dict[str, float]:
        began = time.perf_counter()
        run()
        return {name: (time.perf_counter() - began) / count}

    def image(number: int) -> omad.Observation:
        return observe(depth[number % len(depth)], K, mask=mask[number % len(depth)])

    def one(number: int) -> dict[str, float]:
        kept: list[omad.Estimate] = []
        took = timed("depth to answer", lambda: kept.append(estimator(image(number))))
        return took | {"  of it: refinement": kept[0].seconds["refinement"]}

    def follow(number: int) -> dict[str, float]:
        for time_before in (3 * number, 3 * number + 1):  # until it follows, it searches
            trackers[0](seen[0], 0.03 * time_before)
        return timed("tracking, a frame from memory", lambda: trackers[0](seen[0], 0.03 * (3 * number + 2)))

    return {
        "sgemm": lambda _: timed("sgemm", lambda: torch.mm(a, b, out=c)),
        "from_depth": lambda n: timed(
            "from_depth", lambda: observe(depth[n % len(depth)], K, mask=mask[n % len(depth)])
        ),
        "plane": lambda n: timed("segment plane", lambda: observe(depth[n % len(depth)], K, segment="plane")),
        "one": one,
        "again": lambda n: timed("cloud to answer", lambda: estimator(seen[n % len(seen)])),
        "fast": lambda n: timed("cloud to answer, looks (1, 1)", lambda: fast(seen[n % len(seen)])),
        "labels": lambda n: timed("answer and labels", lambda: estimator(seen[n % len(seen)]).part_labels),
        "bulk": lambda _: timed(
            "bulk, depth to answer, each",
            lambda: estimator([image(i) for i in batch]),
            len(batch),
        ),
        "follow": follow,
    }


STEPS = ("sgemm", "from_depth", "plane", "one", "again", "fast", "labels", "bulk", "follow")


def _work(category: str, path: Path) -> None:
    steps = _steps(category, path)
    for line in sys.stdin:
        name, number = line.split()
        print(json.dumps(steps[name](int(number))), flush=True)


class _Worker:
    def __init__(self, source: Path, category: str, images: Path) -> None:
        command = [sys.executable, __file__, "--work", category, str(images)]
        environment = os.environ | {"PYTHONPATH": str(source)}
        self.process = subprocess.Popen(
            command, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def ask(self, step: str, number: int) -> dict[str, float]:
        assert self.process.stdin
        assert self.process.stdout
        print(step, number, file=self.process.stdin, flush=True)
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"bench_speed: {step} failed; its error is above")
        return json.loads(line)

    def close(self) -> None:
        assert self.process.stdin
        self.process.stdin.close()
        self.process.wait()


# ---- what came out ----


def _summary(category: str, times: dict[str, dict[str, list[float]]]) -> dict[str, object]:
    best = min(min(steps.pop("sgemm")) for steps in times.values())
    rate = 2e-9 * SIZE**3 / best
    floor = 1e3 * PASSES * _gflop(category) / rate
    rows = {
        key: {
            name: {"min_ms": 1e3 * min(steps[key]), "median_ms": 1e3 * float(np.median(steps[key]))}
            for name, steps in times.items()
        }
        for key in times["now"]
    }
    return {"sgemm_gflops": rate, "floor_ms": floor, "steps": rows}


def _training(versions: dict[str, Path], category: str, steps: int, folder: Path) -> dict[str, object]:
    """Clouds a second, by the trainings' own logs; two trainings of each version in turn, the better one counts."""
    rates: dict[str, float] = {}
    for turn in range(2):
        for name, source in versions.items():
            output = folder / f"{name}-{turn}"
            prior = Path(__file__).parents[2] / "src/omad/model/weights" / category / "prior"
            options = ["--category", category, "--prior", str(prior), "--steps", str(steps), "--objects", "24"]
            threads = ["--threads", os.environ.get("OMP_NUM_THREADS", "1"), "--output", str(output)]
            command = [sys.executable, "-m", "omad", "train", "net", *options, *threads]
            environment = os.environ | {"PYTHONPATH": str(source)}
            subprocess.run(command, env=environment, check=True, capture_output=True)
            rows = [json.loads(line) for line in (output / "metrics.jsonl").read_text().splitlines()]
            first, last = rows[0], rows[-1]
            rate = 64 * (last["step"] - first["step"]) / (last["seconds"] - first["seconds"])
            rates[name] = max(rates.get(name, 0.0), rate)
    return {"training_clouds_per_second": rates}


def _table(category: str, found: dict) -> str:
    floor, names = found["floor_ms"], found["steps"]["from_depth"]
    lines = [
        f"{category}: sgemm {found['sgemm_gflops']:.0f} GFLOP/s, floor of {PASSES} passes {floor:.2f} ms",
        f"{'ms, minimum / median; multiple of the floor':<45}" + "".join(f"{name:>28}" for name in names),
    ]
    for key, versions in found["steps"].items():
        cells = "".join(
            f"{v['min_ms']:>10.2f} / {v['median_ms']:<6.2f} {v['min_ms'] / floor:>6.2f} x" for v in versions.values()
        )
        lines.append(f"{key:<45}{cells}")
    if rates := found.get("training_clouds_per_second"):
        lines.append(f"{'training, clouds a second':<45}" + "".join(f"{rate:>28.0f}" for rate in rates.values()))
    return "\n".join(lines)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        _work(sys.argv[2], Path(sys.argv[3]))
    else:
        import tyro

        main(tyro.cli(Config, description=__doc__))
