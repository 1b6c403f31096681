"""Whether the base is as near as ``Estimate.base_std`` says, and as ``Estimate.covariance`` does.

    OMP_NUM_THREADS=1 python benchmarks/certainty/bench_pose_covariance.py [--categories laptop drawer]
        [--objects 100] [--spoilt] [--json]

Noisy standard views of unseen procedural objects, one each; with ``--spoilt`` such views as confidence is learned from,
of these objects. "within" is the share of the errors, about and along the camera's three axes, that are below one
standard deviation: 0.68 if it were true. "times" is the median error in units of what it would then be.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import tyro

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view
from omad.estimation.estimator import Estimator
from omad.estimation.looks.answers import base_std
from omad.evaluation.confidence.fitting import base_errors
from omad.evaluation.confidence.views import Example, examples
from omad.model.checkpoint import shipped_categories
from omad.objects.category import Category

USUAL = NormalDist().inv_cdf(0.75)
"""Median of a normal error, standard deviations."""
BLOCKS = {"rotation": slice(3), "translation": slice(3, 6)}


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    categories: tuple[str, ...] = tuple(shipped_categories())
    objects: int = 100
    spoilt: bool = False
    seed: int = 37
    json: bool = False


def main(config: Config) -> None:
    answer = {name: measure(name, config) for name in config.categories}
    if config.json:
        print(json.dumps(answer))
        return
    for name, found in answer.items():
        print(f"{name:24}" + "   ".join(f"{key} {value:.2f}" for key, value in found.items()))


def shown(category: Category, config: Config) -> Iterator[Example]:
    models = [generate(category, index, "test", config.seed) for index in range(config.objects)]
    if config.spoilt:
        yield from (one for one in examples(models, category, range(config.objects), config.seed) if one.of_category)
        return
    for index, model in enumerate(models):
        yield Example(standard_view(model, category, (config.seed, index), LEVELS["on"]), True)


def measure(name: str, config: Config) -> dict[str, float]:
    estimator = Estimator.from_pretrained(name, device="cpu")
    told, least = [], []
    for example in shown(estimator.category, config):
        estimate = estimator(example.observation())
        errors = base_errors(estimate.T_camera_base, example.view.T_camera_base)
        told.append(errors / estimate.base_std)
        least.append(errors / base_std(estimate.covariance[None])[0])
    found = {}
    for what, block in BLOCKS.items():
        ratios, others = np.array(told)[:, block], np.array(least)[:, block]
        found |= {f"{what} within": float((ratios < 1).mean()), f"{what} times": float(np.median(ratios) / USUAL)}
        found[f"{what} times by covariance"] = float(np.median(others) / USUAL)
    return found


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
