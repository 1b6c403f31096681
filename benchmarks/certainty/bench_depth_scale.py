"""How often a wrong depth scale is named, and the right one doubted.

    OMP_NUM_THREADS=1 python benchmarks/certainty/bench_depth_scale.py [--categories laptop scissors] [--views 30]

Views of unseen procedural objects with camera noise, read at the right depth scale and at those that are mistaken for
it and that the size of a cloud may not tell of; and cluttered scenes at the right one, where many answers are doubtful.
A scale is named where the check-list holds `size` or `scale`, rightly where the cure is the right scale. Of the rest,
the share that is not even doubtful.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.spoils.spoiling import cluttered
from omad.data.rendering.standard_views import standard_view
from omad.estimation.checks import believed, doubts, is_doubtful, scale_doubts, scaled
from omad.estimation.estimator import Estimator
from omad.sensing.observation import Observation

SEED, FIRST, SCALE = 9, 150, 0.001
FACTORS = (1.0, 4.0, 5.0, 0.25, 0.2)
CLUTTERED = "1, clutter"


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = (
        "laptop", "eyeglasses", "dishwasher", "scissors", "drawer", "microwave", "stapler", "refrigerator",
    )  # fmt: skip
    views: int = 30
    """Of each category, each of another object."""


def said(estimator: Estimator, seen: Observation, factor: float) -> np.ndarray:
    """(3,) whether a scale is named, whether the right one is, and whether neither that nor a doubt is told."""
    estimate = estimator(seen)
    checks = doubts(seen, estimate, SCALE)
    sized = [check for check in checks if check.name == "size"]
    named = sized or scale_doubts(seen, believed(estimate, checks), estimator.first_answers, SCALE)
    right = any(f"{SCALE / factor:g}" in check.cure for check in named)
    return np.array([bool(named), right, not named and not is_doubtful(believed(estimate, checks), checks)])


def main(config: Config) -> None:
    columns = [CLUTTERED, *(f"{factor:g}" for factor in FACTORS)]
    print(f"{'named / rightly / no doubt at':30}" + "".join(f"{name:>18}" for name in columns))
    for name in config.categories:
        estimator = Estimator.from_pretrained(name, device="cpu")
        category, told = estimator.category, {column: np.zeros(3) for column in columns}
        for index in range(config.views):
            model = generate(category, FIRST + index, "test")
            seen = standard_view(model, category, (SEED, index), LEVELS["on"]).observation()
            for factor in FACTORS:
                told[f"{factor:g}"] += said(estimator, scaled(seen, factor), factor)
            _, spoilt = cluttered(model, category, (SEED, index))
            told[CLUTTERED] += said(estimator, spoilt.view.observation(), 1.0)
        cells = (" / ".join(f"{share:.0%}" for share in count / config.views) for count in told.values())
        print(f"{name:30}" + "".join(f"{cell:>18}" for cell in cells), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
