"""How long an estimate takes, and how refinement compares with the paper's Adam recipe.

    OMP_NUM_THREADS=1 python benchmarks/speed/bench_refinement.py [--category laptop] [--json]

Rendered standard views of unseen objects go through the shipped network; what its first look gives (targets, weights,
initial values) is the problem. Adam and least squares then solve the same ones, one at a time, without prior, limits
or robust loss; energies are sums of weighted squared keypoint distances. Medians.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import tyro

from omad.common.runtime import keep_freed_memory
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_views
from omad.estimation.estimator import Estimator
from omad.evaluation.baselines.adam import refine_with_adam
from omad.model.fitting.energy import RefinementConfig
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import Refined, State, Targets
from omad.model.network_input import first_frame, sample_clouds
from omad.sensing.observation import Observation

PLAIN = RefinementConfig(prior_weight=0.0, huber=None, limit_sigma=1e6)


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    category: str = "laptop"
    views: int = 32
    batch: int = 256
    """Problems of the batch; the views are repeated to fill it."""
    adam: int = 10
    """Views that Adam solves too."""
    json: bool = False


def median_ms(run: Callable[[int], object], count: int) -> float:
    """Median milliseconds of ``run(0)``, ``run(1)``, ... after one run to warm up."""
    run(0)
    times = []
    for index in range(count):
        began = time.perf_counter()
        run(index)
        times.append(1e3 * (time.perf_counter() - began))
    return float(np.median(times))


@torch.no_grad()
def main(config: Config) -> None:
    keep_freed_memory()
    estimator = Estimator.from_pretrained(config.category, device="cpu")
    category, prior = estimator.category, estimator.net.prior
    models = [generate(category, index, "test") for index in range(20)]
    views = list(standard_views(models, category, config.views))
    observations = [Observation.from_depth(view.depth, view.camera) for view in views]
    size, samples = estimator.net.backbone.config.points, sum(estimator.config.samples)
    clouds, _ = sample_clouds(observations, size, samples, estimator.config.seed, category, "cpu")
    look = estimator._look(clouds[:, :1], first_frame(clouds.flatten(1, 2)), labels=False)
    limits = torch.as_tensor(category.limits).float()

    def problem(rows: torch.Tensor) -> tuple[Targets, State]:
        targets = Targets(look.targets.keypoints[rows], look.targets.weights[rows])
        return targets, State(look.state.beta[rows], look.state.joint_states[rows], look.state.T_camera_base[rows])

    def solve(rows: torch.Tensor, refiner: Refiner) -> Refined:
        return refiner(*problem(rows))

    many = torch.arange(config.batch) % config.views
    default = Refiner(prior, limits, estimator.config.refinement)
    plainly = Refiner(prior, limits, PLAIN)
    answer = {
        "category": category.name,
        "machine": f"{platform.processor() or platform.machine()}, {torch.get_num_threads()} thread(s)",
        "refinement_one_ms": median_ms(lambda i: solve(torch.tensor([i]), default), config.views),
        "refinement_batch_ms_each": median_ms(lambda _: solve(many, default), 5) / config.batch,
    }
    singles = [estimator(observations[i]).seconds for i in [0, *range(config.views)]][1:]
    answer["estimate_one_network_ms"] = 1e3 * float(np.median([s["network"] for s in singles]))
    answer["estimate_one_refinement_ms"] = 1e3 * float(np.median([s["refinement"] for s in singles]))
    answer["estimate_one_total_ms"] = median_ms(lambda i: estimator(observations[i]), config.views)

    plain = [solve(torch.tensor([i]), plainly).energy.item() for i in range(config.adam)]
    answer["plain_one_ms"] = median_ms(lambda i: solve(torch.tensor([i]), plainly), config.adam)
    with torch.enable_grad():
        began = time.perf_counter()
        adam = [refine_with_adam(prior, *problem(torch.tensor([i]))).energy.item() for i in range(config.adam)]
        answer["adam_one_ms"] = 1e3 * (time.perf_counter() - began) / config.adam
    answer["adam_over_ours"] = answer["adam_one_ms"] / answer["plain_one_ms"]
    answer["energy_ours"], answer["energy_adam"] = float(np.median(plain)), float(np.median(adam))
    answer["energy_not_higher"] = bool((np.array(plain) <= np.array(adam) * (1 + 1e-6)).all())
    print(json.dumps(answer) if config.json else "\n".join(f"{key}: {value}" for key, value in answer.items()))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
