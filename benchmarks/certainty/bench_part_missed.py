"""How often answers are wrong, and not doubted, whose mask leaves a part of the object out.

    OMP_NUM_THREADS=1 python benchmarks/certainty/bench_part_missed.py [--categories laptop scissors] [--views 200]

Views of unseen procedural objects with camera noise: the same with a mask of the whole object, and without one of its
parts, at random. Wrong: a joint is off by more than 10 degrees, or 10 % of the object's diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro

from omad.data.rendering.spoils.spoil import Spoil
from omad.data.source import load_views
from omad.estimation.estimator import Estimator
from omad.evaluation.robustness.experiment import measure, scenes_from
from omad.evaluation.robustness.rows import Row

SEED = 3
ROWS = {what: Row(what, Spoil(noise="on", part_missed=what != "whole")) for what in ("whole", "without a part")}


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = ("laptop", "eyeglasses", "dishwasher", "scissors", "drawer")
    views: int = 200
    """Of each category, each of another object."""


def main(config: Config) -> None:
    print(f"{'category':24}{'mask':18}{'wrong':>8}{'doubted':>9}{'wrong, not doubted':>20}")
    for name in config.categories:
        estimator = Estimator.from_pretrained(name, device="cpu")
        views = load_views("procedural", estimator.category, config.views, config.views, SEED, "off", "refuse")
        found = measure(estimator, scenes_from(views, estimator.category, SEED), config.views, ROWS)
        for what, answers in found.items():
            wrong, doubted = (np.array([getattr(one, key) for one in answers]) for key in ("wrong", "flagged"))
            print(f"{name:24}{what:18}{wrong.mean():8.0%}{doubted.mean():9.0%}{(wrong & ~doubted).mean():20.0%}")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
