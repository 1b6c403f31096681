"""How long refinement takes, alone and in batches, and how it compares with the paper's Adam recipe.

    python benchmarks/bench_refinement.py [--category laptop] [--json]

Random objects of a random prior, keypoints with noise, starts such as a network gives (20 degrees, 0.1 units off).
Adam and least squares see the same targets and weights, one problem at a time, without prior, limits or robust loss;
energies are sums of weighted squared keypoint distances. Medians; run it with OMP_NUM_THREADS=1 on a shared machine.
"""

from __future__ import annotations

import json
import math
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
import tyro

from omad.adam_recipe import refine_with_adam
from omad.categories import get_category
from omad.geometry import make_transform, so3_exp
from omad.prior import OmadPrior
from omad.refinement import RefinementConfig, State, Targets, refine


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    category: str = "laptop"
    batch: int = 256
    problems: int = 20
    """Problems solved one at a time; Adam gets the first ``adam_problems`` of them."""
    adam_problems: int = 5
    noise: float = 0.03
    """Standard deviation of the targets, category units."""
    seed: int = 0
    json: bool = False
    """Print one JSON object."""


@dataclass(frozen=True)
class Problems:
    """B refinement problems."""

    prior: OmadPrior
    targets: Targets
    start: State
    limits: torch.Tensor

    def __getitem__(self, rows: slice) -> Problems:
        start = State(self.start.beta[rows], self.start.joint_states[rows], self.start.T_camera_base[rows])
        targets = Targets(self.targets.keypoints[rows], self.targets.weights[rows])
        return Problems(self.prior, targets, start, self.limits)


def draw_problems(config: Config) -> Problems:
    draw = torch.Generator().manual_seed(config.seed)
    category = get_category(config.category)
    prior = OmadPrior(category, generator=draw).requires_grad_(False)
    limits = torch.tensor([joint.limits for joint in category.joints])
    count, joints = config.batch, len(limits)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=draw)

    beta = normal(count, prior.basis_size)
    states = limits[:, 0] + torch.rand(count, joints, generator=draw) * (limits[:, 1] - limits[:, 0])
    T = make_transform(so3_exp(normal(count, 3)), normal(count, 3) + torch.tensor([0.0, 0.0, 4.0]))
    keypoints = prior.deform(beta, states, T)
    weights = torch.full(keypoints.shape[:2], config.noise**-2)
    turn = math.radians(20) * torch.nn.functional.normalize(normal(count, 3), dim=-1)
    start = State(
        beta + 0.3 * normal(count, prior.basis_size),
        states + math.radians(20) * normal(count, joints).sign(),
        make_transform(so3_exp(turn) @ T[:, :3, :3], T[:, :3, 3] + 0.1 * normal(count, 3)),
    )
    return Problems(prior, Targets(keypoints + config.noise * normal(*keypoints.shape), weights), start, limits)


def median_ms(run: Callable[[int], object], count: int) -> float:
    """Median wall-clock milliseconds of ``run(0) ... run(count - 1)``."""
    times = []
    for index in range(count):
        began = time.perf_counter()
        run(index)
        times.append(1e3 * (time.perf_counter() - began))
    return torch.tensor(times).median().item()


def measure(config: Config) -> dict[str, object]:
    problems = draw_problems(config)

    def solve(part: Problems, settings: RefinementConfig):
        return refine(part.prior, part.targets, part.start, part.limits, settings)

    ms: dict[str, float] = {}
    for backend in ("kernel", "torch"):
        settings = RefinementConfig(backend=backend)
        solve(problems[:1], settings)  # compile, or load what was compiled
        singles = [problems[i : i + 1] for i in range(config.problems)]
        ms[f"{backend}_alone"] = median_ms(lambda i, s=settings, p=singles: solve(p[i], s), config.problems)
        ms[f"{backend}_in_batch"] = median_ms(lambda _, s=settings: solve(problems, s), 7) / config.batch

    plain = RefinementConfig(prior_weight=0.0, limit_sigma=1e6, huber=None)
    energies: dict[str, list[float]] = {"kernel": [], "adam": []}

    def least_squares(index: int) -> None:
        energies["kernel"].append(solve(problems[index : index + 1], plain).energy.item())

    def adam(index: int) -> None:
        one = problems[index : index + 1]
        energies["adam"].append(refine_with_adam(one.prior, one.targets, one.start).energy.item())

    ms["kernel_same_energy_as_adam"] = median_ms(least_squares, config.adam_problems)
    ms["adam_alone"] = median_ms(adam, config.adam_problems)
    pairs = list(zip(energies["kernel"], energies["adam"], strict=True))
    return {
        "category": config.category,
        "batch": config.batch,
        "machine": f"{platform.machine()}, {torch.get_num_threads()} threads, torch {torch.__version__}",
        "milliseconds_per_problem": ms,
        "adam_over_kernel": ms["adam_alone"] / ms["kernel_same_energy_as_adam"],
        "median_energy": {name: torch.tensor(values).median().item() for name, values in energies.items()},
        "kernel_energy_never_higher": all(ours <= theirs for ours, theirs in pairs),
    }


def main() -> None:
    config = tyro.cli(Config, description=__doc__)
    result = measure(config)
    if config.json:
        json.dump(result, sys.stdout)
        print()
        return
    print(f"{result['category']}, batch {config.batch}, {result['machine']}")
    milliseconds, energy = result["milliseconds_per_problem"], result["median_energy"]
    assert isinstance(milliseconds, dict)
    assert isinstance(energy, dict)
    for name, value in milliseconds.items():
        print(f"  {name.replace('_', ' '):30} {value:10.3f} ms a problem")
    print(f"  Adam / kernel, one at a time   {result['adam_over_kernel']:10.0f} x")
    print(f"  median energy                  {energy['kernel']:10.2f} kernel, {energy['adam']:.2f} Adam")
    print(f"  kernel's energy never higher   {result['kernel_energy_never_higher']!s:>10}")


if __name__ == "__main__":
    main()
