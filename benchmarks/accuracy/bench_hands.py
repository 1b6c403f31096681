"""How often objects that may be of either hand are taken for the right one, by how far their doors are open and by how
sure the answer is.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_hands.py [--categories cabinet_one_door safe] [--views 400]

Views are standard ones with camera noise of unseen procedural objects; every third shows a door open by 6 degrees at
most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import tyro
from tqdm import tqdm

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view
from omad.estimation.estimator import Estimator
from omad.model.checkpoint import shipped_categories
from omad.objects.category_file import get_category

OBJECTS, SEED = 20, 2
SHUT = np.radians(6)
OPEN = (0, 2, 6, 10, 30, 180)
"""Degrees."""
SURE = (0.5, 0.65, 0.75, 0.9, 0.99, 1.0)


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = ()
    """Default: all that have weights and may be of either hand."""
    views: int = 300
    """Of each category."""


def seen(name: str, views: int) -> np.ndarray:
    """(views, 3) door's state in degrees, how sure the answer is of the hand, and whether it is right."""
    estimator = Estimator.from_pretrained(name, "cpu")
    models = [generate(estimator.category, index, "test", SEED) for index in range(OBJECTS)]
    rows = []
    for index in tqdm(range(views), desc=name):
        model = models[index % OBJECTS]
        if index % 3 == 0:
            model = replace(model, limits=np.clip(model.limits, None, SHUT))
        view = standard_view(model, estimator.category, (SEED, index), LEVELS["on"])
        estimate = estimator(view.observation())
        rows.append((np.degrees(view.states[0]), estimate.hand_probability, not estimate.of_other_hand))
    return np.array(rows, dtype=float)


def told(values: np.ndarray, right: np.ndarray, edges: tuple[float, ...]) -> str:
    """Share of right ones between edges, and how many there are."""
    shares = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        inside = (values >= low) & (values <= high if high == edges[-1] else values < high)
        shares.append(f"{low:g} to {high:g}: {right[inside].mean() if inside.any() else np.nan:.2f} of {inside.sum()}")
    return ", ".join(shares)


def main(config: Config) -> None:
    handed = [name for name in shipped_categories() if get_category(name).either_hand]
    found = {name: seen(name, config.views) for name in config.categories or handed}
    for name, rows in {**found, "all": np.concatenate(list(found.values()))}.items():
        state, probability, right = rows.T
        print(f"{name}: right at degrees {told(state, right, OPEN)}")
        print(f"{name}: right where told {told(probability, right, SURE)}")


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
