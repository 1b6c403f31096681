"""What a network gains by beginning with what another category's knows, after how many steps of training.

    python benchmarks/accuracy/bench_initial.py [--category refrigerator_two_doors] [--initial refrigerator]
        [--steps 350 1000]

Two trainings of one core each go on side by side, one from nothing and one from the other category, on the same prior
and the same spoilt views of the same objects; each has a whole schedule of its own, decay of the learning rate and all.
At 70 clouds a second, 350, 1000 and 4000 steps are 5, 15 and 60 minutes of a core. Then both answer the same noisy
views of objects that neither has seen. Trainings are kept in ``--output``: a stopped run goes on where it was.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from omad.model.checkpoint import find_weights

OMAD = (sys.executable, "-m", "omad")


@dataclass(frozen=True)
class Config:
    """What to train and to measure."""

    category: str = "refrigerator_two_doors"
    initial: str = "refrigerator"
    steps: tuple[int, ...] = (350, 1000, 4000)
    views: int = 200
    objects: int = 20
    output: Path = Path("runs/initial")


def trained(config: Config, steps: int) -> dict[str, Path]:
    """Checkpoint folders by what they began with."""
    prior = find_weights(config.category) / "prior"
    common = ["--category", config.category, "--prior", prior, "--clutter", "--steps", steps]
    begun = {"nothing": [], config.initial: ["--initial", config.initial]}
    folders = {name: config.output / f"{config.category}-{steps}-{name}" for name in begun}
    commands = [
        [*OMAD, "train", "net", *common, *begun[name], "--threads", 1, "--output", folder]
        for name, folder in folders.items()
        if not (folder / "model.safetensors").exists()
    ]
    running = [subprocess.Popen([*map(str, command)]) for command in commands]
    if any([process.wait() for process in running]):
        raise SystemExit("a training failed; its message stands above")
    return folders


def measured(config: Config, weights: Path) -> str:
    """Errors of the refined answer, in words."""
    views = ["--views", config.views, "--objects", config.objects, "--depth-noise", "on"]
    command = [*OMAD, "eval", "pose", "--category", config.category, "--weights", weights, *views, "--json"]
    answer = json.loads(subprocess.run([*map(str, command)], check=True, capture_output=True).stdout)
    refined = answer["refined"]
    states, axes = refined["joint_state_error_deg"], refined["axis_error_deg"]
    told = [f"{state['mean']:.1f} / {state['median']:.1f}" for state in states if state is not None]
    told += [f"axis {axis['mean']:.1f} / {axis['median']:.1f}" for axis in axes]
    return f"{', '.join(told)}; within 5 degrees, 5 %: {refined['within_5deg_5percent']:.0%}"


def main(config: Config) -> None:
    print("mean / median, degrees")
    for steps in config.steps:
        for begun, weights in trained(config, steps).items():
            print(f"{steps} steps from {begun}: {measured(config, weights)}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
