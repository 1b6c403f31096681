"""How many objects of cluttered scenes ``omad detect`` finds, how many answers are false, and how long it takes.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_detect.py [--scenes 20] [--kinds floor] [--fit]

Scenes are of three to six objects on a table (laptops, eyeglasses) or a floor (dishwashers, drawer cabinets), boxes and
cans among them, with camera noise: unseen procedural objects at their real sizes. In ``shrunk`` scenes dishwashers and
cabinets are shrunk to 0.45 m, a size that no network was trained for. ``small`` and ``large`` scenes are of all
categories with weights that stand by themselves. ``raised`` scenes are of laptops and eyeglasses on a table that ends
beside them, over a floor; ``walled`` ones of the same before a wall, and ``room`` ones of dishwashers and cabinets on a
floor before a wall. An object is found where an answer of its
category shares half of its pixels with it; any other answer that names a category is false. ``--fit`` works on objects
of the training split instead, and writes the weights that detection uses.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from scipy.optimize import minimize
from scipy.special import log_softmax

from omad.applications.detection.detector import Detection, Detector
from omad.applications.detection.judgement import Judgement
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.tabletop import Surroundings, Tabletop, TabletopObject, draw_tabletop
from omad.estimation.categories.late import LateEstimator
from omad.model.checkpoint import shipped_categories
from omad.objects.category_file import get_category
from omad.sensing.observation import Observation

LYING = ("scissors", "pliers")
"""What lies flat is no thing that stands before a table."""
SIZES = {name: get_category(name).metres_per_unit for name in shipped_categories() if name not in LYING}
LARGE = 0.35
"""Metres a unit."""
KINDS = {
    "table": (("laptop", "eyeglasses"), np.inf, None),
    "floor": (("dishwasher", "drawer"), np.inf, None),
    "shrunk": (("laptop", "eyeglasses", "dishwasher", "drawer"), 0.45, None),
    "small": (tuple(name for name, size in SIZES.items() if size < LARGE), np.inf, None),
    "large": (tuple(name for name, size in SIZES.items() if size >= LARGE), np.inf, None),
    "raised": (("laptop", "eyeglasses"), np.inf, Surroundings(raised=True)),
    "walled": (("laptop", "eyeglasses"), np.inf, Surroundings(raised=True, wall=True)),
    "room": (("dishwasher", "drawer"), np.inf, Surroundings(wall=True)),
}
"""Categories of the scenes, the largest diagonal in metres, and what is around them."""
OVERLAP = 0.5
NUMBERS = 13
"""Of the evidence."""
RIDGE, ALIKE = 1e-3, 3e-3
"""Keep weights finite, and those of the categories near to each other."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    scenes: int = 20
    """Of each kind."""
    fit: bool = False
    seed: int = 0
    kinds: tuple[str, ...] = ("table", "floor", "shrunk")
    """Of scenes to measure on."""
    categories: tuple[str, ...] = ()
    """That are asked for; default: all that have weights."""
    weights: Path | None = None
    """Folder with a sub-folder a category in place of the shipped weights."""


def scenes(config: Config, kind: int, split: Literal["train", "test"]) -> Iterator[Tabletop]:
    categories, largest, around = list(KINDS.values())[kind]
    own = (1,) if split == "train" else ()  # boxes and cans, which are of no split, are others, too
    for index in range(config.scenes):
        seed = index + 1000 * config.seed, kind, *own
        yield draw_tabletop(categories, seed, split, ON, largest, surroundings=around)


def shared(found: Detection, placed: TabletopObject, scene: Tabletop) -> float:
    """Pixels of both as a share of those of either."""
    mask, truth = found.observation.mask, placed.mask & (scene.depth > 0)
    assert mask is not None
    return float((mask & truth).sum() / max((mask | truth).sum(), 1))


def measure(config: Config, detector: Detector) -> None:
    print("| scenes | objects | found | answers | false | category wrong | s a scene |\n|---|---|---|---|---|---|---|")
    for number, kind in enumerate(KINDS):
        if kind not in config.kinds:
            continue
        there = found = answers = false = confused = 0
        seconds = []
        for scene in scenes(config, number, "test"):
            began = time.perf_counter()
            detections = detector(Observation.from_depth(scene.depth, scene.camera))
            seconds.append(time.perf_counter() - began)
            named = [one for one in detections if one.category is not None]
            for one in named:
                over = [placed for placed in scene.objects if shared(one, placed, scene) > OVERLAP]
                right = any(placed.category == one.category for placed in over)
                false += not right
                confused += not right and any(placed.category is not None for placed in over)
            for placed in (placed for placed in scene.objects if placed.category and placed.to_be_found):
                there += 1
                same = [one for one in named if one.category == placed.category]
                found += any(shared(one, placed, scene) > OVERLAP for one in same)
            answers += len(named)
        share = f"{found} ({found / there:.0%}) | {answers} | {false} ({false / max(answers, 1):.0%})"
        print(f"| {kind} | {there} | {share} | {confused} | {np.median(seconds):.2f} |", flush=True)


@dataclass(frozen=True)
class Example:
    """What speaks against each category that was fitted to a thing, and which it is of."""

    evidence: Mapping[str, np.ndarray]
    truth: str | None


def fit(config: Config, detector: Detector) -> Judgement:
    """Weights under which the true categories, or none, are likeliest."""
    found = []
    for number in (0, 1, 3, 4):  # but for objects that were shrunk: no network has learned from such
        for scene in scenes(config, number, "train"):
            for one in detector(Observation.from_depth(scene.depth, scene.camera)):
                over = [placed.category for placed in scene.objects if shared(one, placed, scene) > OVERLAP]
                found.append(Example(one.evidence, over[0] if over else None))
    return fitted([one.category.name for one in detector.estimators if one.category.name not in LYING], found)


def fitted(names: Sequence[str], found: Sequence[Example]) -> Judgement:
    """The same, of things already looked at."""
    values = np.array([[one.evidence.get(name, np.zeros(NUMBERS)) for name in names] for one in found])
    left_out = np.array([[name not in one.evidence for name in names] for one in found])
    which = np.array([names.index(one.truth) if one.truth in one.evidence else len(names) for one in found])
    spread = values[~left_out].std(0)
    values, shape = values / spread, (len(names), NUMBERS)
    true = np.eye(len(names) + 1)[which]

    def loss(free: np.ndarray) -> tuple[float, np.ndarray]:
        weights, offsets = free[: -len(names)].reshape(shape), free[-len(names) :]
        scores = np.where(left_out, -50.0, offsets - (values * weights).sum(-1))
        logs = log_softmax(np.concatenate([scores, np.zeros((len(scores), 1))], 1), 1)
        by_score = np.where(left_out, 0.0, (np.exp(logs) - true)[:, :-1]) / len(logs)
        usual, odd, apart = weights.mean(0), weights - weights.mean(0), offsets - offsets.mean()
        ridge = RIDGE * usual @ usual + ALIKE * (np.square(odd).sum() + np.square(apart).sum())
        by_weights = 2 * RIDGE * usual / len(names) + 2 * ALIKE * odd - (by_score[..., None] * values).sum(0)
        by_offsets = 2 * ALIKE * apart + by_score.sum(0)
        return float(ridge - (true * logs).sum(1).mean()), np.concatenate([by_weights.ravel(), by_offsets])

    bounds = [(0, None)] * (len(names) * NUMBERS) + [(None, None)] * len(names)
    best = minimize(loss, np.ones(len(bounds)), jac=True, bounds=bounds).x
    weights = (best[: -len(names)].reshape(shape) / spread).round(3).tolist()
    offsets = best[-len(names) :].round(3).tolist()
    return Judgement(dict(zip(names, weights, strict=True)), dict(zip(names, offsets, strict=True)))


def main(config: Config) -> None:
    names = config.categories or shipped_categories()
    folders = [config.weights / name if config.weights else name for name in names]
    detector = Detector([LateEstimator.of(folder) for folder in folders])
    if config.fit:
        judgement = fit(config, detector)
        judgement.save()
        print(judgement)
    else:
        measure(config, detector)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
