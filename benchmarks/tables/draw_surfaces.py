"""Objects of five categories beside the surfaces that are estimated of one view of each.

    python benchmarks/tables/draw_surfaces.py --output docs/figures/hero.png                # procedural, unseen
    python benchmarks/tables/draw_surfaces.py --models FOLDER --output docs/figures/surfaces.png  # other people's

``FOLDER/<category>/`` holds models; of each category the first that fits is seen once, from a side that the seed draws.
"""

from __future__ import annotations

from pathlib import Path

import tyro

from omad.data.rendering.standard_views import standard_view
from omad.data.source import load_models
from omad.estimation.estimator import Estimator
from omad.evaluation.figures.style import save
from omad.evaluation.figures.surfaces import Seen, draw

CATEGORIES = ("laptop", "eyeglasses", "dishwasher", "scissors", "drawer")


def main(output: Path, models: Path | None = None, seed: int = 0, number: int = 0) -> None:
    shown = []
    for name in CATEGORIES:
        estimator = Estimator.from_pretrained(name, "cpu")
        category = estimator.category
        found = load_models("procedural" if models is None else str(models / name), category, number + 1, "test", 0)
        model = found.models[min(number, len(found.models) - 1)]
        view = standard_view(model, category, (seed, number))
        shown.append(Seen(view, estimator(view.observation()), model))
    save(draw(shown), output)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
