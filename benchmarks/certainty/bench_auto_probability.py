"""How well answers of ``--category auto`` know that category and joint states are right, by their probability.

    OMP_NUM_THREADS=1 python benchmarks/certainty/bench_auto_probability.py [--models FOLDER] [--views 12]

It is made of that of the category and the answer's own: multiplied (as it is done), their odds against added up, or the
smaller of both. Views are standard ones with camera noise, of procedural and unusual test objects, of strangers, and of
the models in ``FOLDER/<category>/`` where one is given.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from omad.data.procedural.strangers import strangers
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import View, standard_view, true_pose
from omad.data.source import load_models
from omad.estimation.categories.late import shipped_estimators
from omad.estimation.categories.ranking import rank
from omad.estimation.estimate import DOUBTFUL, Estimate
from omad.estimation.known import NOTHING_KNOWN
from omad.evaluation.calibration import area_under_roc, expected_calibration_error
from omad.evaluation.metrics import pose_errors
from omad.objects.category import Category

UNSEEN = 3
"""Seed of the objects."""
STRANGERS = 5
"""So many times as many views show strangers as show one category."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    models: Path | None = None
    views: int = 12
    """A category and source."""


def shown(config: Config, source: str, categories: list[Category]) -> Iterator[tuple[Category | None, View]]:
    """Views of a source with the category that they are of."""
    if source == "strangers":
        groups = strangers(STRANGERS * config.views, UNSEEN)
        objects = [(None, group.category, model) for group in groups for model in group.models]
    else:
        objects = []
        for category in categories:
            place = f"{source}/{category.name}" if Path(source).is_dir() else source
            if place == source or Path(place).is_dir():
                models = load_models(place, category, config.views, "test", UNSEEN).models
                objects += [(category, category, model) for model in islice(cycle(models), config.views)]
    for index, (truth, category, model) in enumerate(objects):
        yield truth, standard_view(model, category, (UNSEEN, index), LEVELS["on"])


def is_right(answer: Estimate, view: View, truth: Category | None) -> bool:
    """Whether category and joint states are."""
    if truth is None or answer.category.name != truth.name:
        return False
    found = pose_errors(answer.pose(), true_pose(view, truth), view.truth.part_boxes, truth)
    return found.right(truth, view.truth.diagonal)


def main(config: Config) -> None:
    estimators = {one.category.name: one for one in shipped_estimators()}
    categories = [one.category for one in estimators.values()]
    sources = ["procedural", "unusual", "strangers", *([] if config.models is None else [str(config.models)])]
    told, every = dict[str, np.ndarray](), []
    for source in sources:
        rows = []
        for truth, view in tqdm(list(shown(config, source, categories)), desc=source):
            observation = view.observation()
            ranking = rank(observation, list(estimators.values()))
            if not ranking.candidates:
                continue
            first, probability = ranking.candidates[0].estimate, ranking.candidates[0].probability
            own = estimators[first.category.name]
            [answer] = own.reconsidered([observation], [first], NOTHING_KNOWN.of(own.category))
            both = max(answer.probability or 0.0, 1e-9), max(probability, 1e-9)
            ways = np.prod(both), 1 / (1 / both[0] + 1 / both[1] - 1), min(both)
            rows.append([*ways, is_right(answer, view, truth)])
        told[source] = np.array(rows, dtype=float)
        every.append(told[source])
    for source, rows in (told | {"all": np.concatenate(every)}).items():
        right = rows[:, -1] > 0
        print(f"{source}: {len(rows)} answers, {right.mean():.1%} right")
        for name, said in zip(("multiplied", "odds against added up", "the smaller"), rows.T, strict=False):
            error, area = expected_calibration_error(said, right), area_under_roc(said, right)
            sure = np.count_nonzero((said >= DOUBTFUL) & ~right)
            print(f"  {name:22} calibration error {error:.3f}, area under the ROC {area:.3f}, wrong but sure {sure}")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
