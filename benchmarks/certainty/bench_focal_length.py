"""How often a wrong focal length is told, and the right one doubted.

    OMP_NUM_THREADS=1 python benchmarks/certainty/bench_focal_length.py [--categories laptop scissors] [--views 30]

Views of unseen procedural objects with camera noise, given with the right focal length, two thirds of it, and one and a
half times as much. A wrong one is told where the check-list holds `intrinsics`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import tyro

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view
from omad.estimation.checks import camera_doubts
from omad.estimation.estimator import Estimator
from omad.sensing.observation import Observation

SEED, FIRST = 9, 150
GIVEN = {"right": 1.0, "two thirds": 2 / 3, "one and a half": 1.5}


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = (
        "laptop", "eyeglasses", "dishwasher", "scissors", "drawer", "microwave", "stapler", "refrigerator",
    )  # fmt: skip
    views: int = 30
    """Of each category, each of another object."""


def with_focal_length(seen: Observation, factor: float) -> Observation:
    """As it is read with ``factor`` times the camera's focal length."""
    assert seen.camera is not None
    camera = replace(seen.camera, fx=seen.camera.fx * factor, fy=seen.camera.fy * factor)
    return replace(seen, camera=camera, points=seen.points / np.array([factor, factor, 1], np.float32))


def main(config: Config) -> None:
    print(f"{'told of':14}" + "".join(f"{name:>16}" for name in GIVEN))
    for name in config.categories:
        estimator = Estimator.from_pretrained(name, device="cpu")
        category, told = estimator.category, dict.fromkeys(GIVEN, 0)
        for index in range(config.views):
            model = generate(category, FIRST + index, "test")
            seen = standard_view(model, category, (SEED, index), LEVELS["on"]).observation()
            for given, factor in GIVEN.items():
                wrong = with_focal_length(seen, factor)
                told[given] += bool(camera_doubts(wrong, estimator(wrong), estimator))
        print(f"{name:14}" + "".join(f"{count / config.views:16.0%}" for count in told.values()), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
