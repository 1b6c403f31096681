"""How often ``--category auto`` finds the category of unseen objects: a confusion matrix, and the fit of its weights.

    OMP_NUM_THREADS=1 python benchmarks/bench_auto_category.py [--models FOLDER] [--views 20] [--fit]

Views are standard ones with camera noise, of procedural test objects, and of the models in ``FOLDER/<category>/`` where
one is given. ``--fit`` works on objects of the training split instead and prints the weights for
``category_ranking.py``.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import tyro
from scipy.optimize import minimize
from scipy.special import logsumexp
from tqdm import tqdm

from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view
from omad.data.source import load_models
from omad.estimation.category_ranking import LOG_ODDS, against
from omad.estimation.estimator import Estimator
from omad.estimation.evidence import Evidence, measure_evidence
from omad.model.checkpoint import shipped_categories
from omad.sensing.observation import Observation

OBJECTS = 10
"""Procedural ones a category; of a folder all are taken."""
FIELDS = [*(field.name for field in fields(Evidence)), "in_front", "behind", "missing"]
RIDGE = 1e-3
"""Keeps weights finite where the views are told apart without error."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    models: Path | None = None
    views: int = 20
    """A category and source."""
    noise: str = "on"
    fit: bool = False
    """Fit the weights, on views of training objects."""
    seed: int = 0


@dataclass(frozen=True)
class Look:
    """One view through the eyes of every category."""

    source: str
    truth: int
    evidence: np.ndarray
    """(C, 8)."""


def looks(config: Config, estimators: list[Estimator], source: str, truth: int) -> list[Look]:
    """Views of one category's objects."""
    category = estimators[truth].category
    folder = source if source == "procedural" else f"{source}/{category.name}"
    models = load_models(folder, category, OBJECTS, "train" if config.fit else "test", config.seed).models
    seen = []
    for index in range(config.views):
        seed = (config.seed, 77, index)
        view = standard_view(models[index % len(models)], category, seed, LEVELS[config.noise])
        seen.append(Observation.from_depth(view.depth, view.camera))
    answers = [(estimator, estimator(seen)) for estimator in estimators]
    return [
        Look(
            source,
            truth,
            np.stack(
                [
                    against(observation, found[i], measure_evidence(observation, found[i], estimator.net.prior))
                    for estimator, found in answers
                ]
            ),
        )
        for i, observation in enumerate(seen)
    ]


def fitted(found: list[Look]) -> np.ndarray:
    """Weights (8,), none negative, under which the true categories are likeliest."""
    evidence, truth = np.stack([look.evidence for look in found]), np.array([look.truth for look in found])
    spread = evidence.std((0, 1))

    def loss(scaled: np.ndarray) -> float:
        scores = -(evidence / spread) @ scaled
        right = scores[np.arange(len(truth)), truth]
        return float((logsumexp(scores, 1) - right).mean() + RIDGE * scaled @ scaled)

    return minimize(loss, np.ones(len(spread)), bounds=[(0, None)] * len(spread)).x / spread


def confusion(found: list[Look], names: list[str], weights: np.ndarray) -> str:
    """Rows: true categories; columns: those found."""
    count = np.zeros((len(names), len(names)), dtype=int)
    for look in found:
        count[look.truth, np.nan_to_num(look.evidence @ weights, nan=np.inf).argmin()] += 1
    lines = ["| true \\ found | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    lines += [f"| {name} | " + " | ".join(map(str, row)) + " |" for name, row in zip(names, count, strict=True)]
    return "\n".join([*lines, f"right: {np.trace(count)} of {count.sum()}"])


def main(config: Config) -> None:
    estimators = [Estimator.from_pretrained(name, "cpu") for name in shipped_categories()]
    names = [estimator.category.name for estimator in estimators]
    sources = ["procedural"] if config.models is None or config.fit else ["procedural", str(config.models)]
    for source in sources:
        known = [i for i, name in enumerate(names) if source == "procedural" or (Path(source) / name).is_dir()]
        found = [look for i in tqdm(known, desc=source) for look in looks(config, estimators, source, i)]
        print(f"{source}, {config.views} views a category, noise {config.noise}")
        print(confusion(found, names, LOG_ODDS))
        for number, name in enumerate(FIELDS):
            alone = np.eye(len(FIELDS))[number]
            print(f"{name} alone, {confusion(found, names, alone).splitlines()[-1]}")
        if config.fit:
            weights = fitted(found)
            print("fitted:", ", ".join(f"{weight:.3g}" for weight in weights))
            print(confusion(found, names, weights))


if __name__ == "__main__":
    main(tyro.cli(Config))
