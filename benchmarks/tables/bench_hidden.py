"""Joint state errors where a quarter of an object is hidden, by how much is left to see of the parts a joint links.

    OMP_NUM_THREADS=1 python benchmarks/tables/bench_hidden.py [--categories eyeglasses dishwasher] [--views 120]

The same views of unseen procedural objects whole and with a box, a can or another object before them; of the joint's
two parts the one counts of which less is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro
from tqdm import tqdm

from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.spoils.scenes import draw_scene
from omad.data.rendering.spoils.spoil import Spoil, Staging
from omad.data.rendering.spoils.spoiling import spoilt
from omad.data.rendering.standard_views import View, true_pose
from omad.estimation.estimator import Estimator
from omad.evaluation.metrics import pose_errors

OBJECTS, SEED = 20, 0
LEFT = (0, 0.25, 0.5, 1.01)


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = ("laptop", "eyeglasses", "dishwasher", "scissors", "drawer")
    views: int = 120
    """Of each category."""
    hidden: float = 0.25
    """Share of the pixels."""


def pixels(view: View, parts: int) -> np.ndarray:
    """(P,) that each part has."""
    return np.bincount(view.labels[view.labels < parts], minlength=parts)


def joint_errors(estimator: Estimator, view: View) -> np.ndarray:
    """(J,) degrees, or category units."""
    category = estimator.category
    found = estimator(view.observation()).pose()
    off = pose_errors(found, true_pose(view, category), view.truth.part_boxes, category).joint_state
    return np.where(category.turning, np.degrees(off), off / category.metres_per_unit)


def measured(name: str, config: Config) -> np.ndarray:
    """(N, 3) of joints: share that is left, error in the whole view, and error in the one with something before it."""
    estimator = Estimator.from_pretrained(name, "cpu")
    category, rows = estimator.category, []
    models = [generate(category, index, "test", SEED) for index in range(OBJECTS)]
    child = np.arange(1, len(category.parts))
    parent = np.array([joint.parent for joint in category.joints])
    for index in tqdm(range(config.views), desc=name):
        scene = draw_scene(models[index % OBJECTS], category, (SEED, index), Staging())
        views = [spoilt(scene, Spoil(hidden=hidden)).view for hidden in (0.0, config.hidden)]
        try:
            whole, hidden = (joint_errors(estimator, view) for view in views)
        except InputError:  # too little is left
            continue
        before, after = (pixels(view, len(category.parts)) for view in views)
        left = np.where(before > 0, after / np.maximum(before, 1), 1.0)
        rows += zip(np.minimum(left[child], left[parent]), whole, hidden, strict=True)
    return np.array(rows)


def main(config: Config) -> None:
    print("share left of the joint's parts: joints, mean error whole -> hidden (median)")
    for name in config.categories:
        left, whole, hidden = measured(name, config).T
        told = []
        for low, high in zip(LEFT[:-1], LEFT[1:], strict=True):
            some = (left >= low) & (left < high)
            if some.any():
                means = f"{whole[some].mean():.3g} -> {hidden[some].mean():.3g}"
                told.append(f"from {low:g}: {some.sum()}, {means} ({np.median(hidden[some]):.3g})")
        print(f"{name}: {'; '.join(told)}", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
