"""How often bases are turned the wrong way: without looks from turned frames, with those at what the network is unsure
of, and with those where answers are improbable, too; how many these are.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_turned.py [--categories laptop suitcase] [--rows clean below]

Views of unseen procedural objects, spoilt as the rows of `omad eval robustness` are; how many of the bases are more
than 30 degrees off, and the mean joint state error (degrees or units).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro

from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.spoils.scenes import draw_scene
from omad.data.rendering.spoils.spoiling import spoilt
from omad.data.rendering.standard_views import View, true_pose
from omad.estimation import estimator as module
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.estimation.looks.improbable import is_improbable
from omad.evaluation.metrics import pose_errors
from omad.evaluation.robustness.rows import ROWS

OBJECTS, SEED = 40, 5
TURNED = np.radians(30)


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = (
        "laptop", "eyeglasses", "dishwasher", "scissors", "drawer", "drawer_1", "lidded_box", "suitcase", "trash_can",
    )  # fmt: skip
    rows: tuple[str, ...] = ("noise", "around", "below", "cut-off-25", "together")
    views: int = 200
    """Of each row of each category."""


def spoilt_views(estimator: Estimator, row: str, count: int) -> list[View]:
    """Without those that show too little."""
    category, how, views = estimator.category, ROWS[row].spoil, []
    models = [generate(category, index, "test", SEED) for index in range(OBJECTS)]
    for index in range(count):
        try:
            scene = draw_scene(models[index % OBJECTS], category, (SEED, index), how.staging)
            view = spoilt(scene, how).view
            view.observation()
        except InputError:
            continue
        views.append(view)
    return views


def told(answers: list[Estimate], views: list[View]) -> str:
    """How many bases are turned, and the mean error of joint states."""
    category = answers[0].category
    errors = [
        pose_errors(answer.pose(), true_pose(view, category), view.truth.part_boxes, category)
        for answer, view in zip(answers, views, strict=True)
    ]
    off = np.mean([one.joint_state / category.state_units for one in errors])
    turned = sum(bool(one.rotation[0] > TURNED) for one in errors)
    return f"{turned:4} {np.degrees(off) if all(category.turning) else off:8.3f}"


def main(config: Config) -> None:
    usual = module.UNSURE
    print(f"{'':24} views        without         unsure     improbable, too")
    for name in config.categories:
        estimator = Estimator.from_pretrained(name, "cpu")
        for row in config.rows:
            views, columns, answers = spoilt_views(estimator, row, config.views), [], []
            seen = [view.observation() for view in views]
            for module.UNSURE in (np.inf, usual):
                answers = estimator.first_answers(seen)
                columns.append(told(answers, views))
            columns.append(told(estimator.reconsidered(seen, answers), views))
            columns.append(f"({sum(map(is_improbable, answers))})")
            print(f"{name + ' ' + row:24} {len(views):5} " + "  ".join(columns), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
