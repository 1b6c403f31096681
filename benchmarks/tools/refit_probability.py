"""Fit anew how likely answers of shipped weights are right; their intervals, and how they tell the hand, stay.

    OMP_NUM_THREADS=1 python benchmarks/tools/refit_probability.py CATEGORY ... [--views 4000]

For views that ``omad train confidence`` shows now and did not when the weights were fitted, where only the probability
learns from these (masks that leave a part out): a quarter of an hour a category. As only improbable answers are looked
at again, errors hardly change, but they do: measure the tables anew.
"""

from __future__ import annotations

from dataclasses import replace

import tyro

from omad.cli.training.fitted import UNSEEN
from omad.common.errors import InputError
from omad.data.source import load_models
from omad.estimation.confidence.model import Confidence
from omad.estimation.estimator import Estimator
from omad.evaluation.confidence.fitting import answered, fit_right
from omad.model.checkpoint import find_weights, load
from omad.model.omadnet import OmadNet
from omad.model.surfaces.surfaces import Surfaces

OBJECTS, SEED = 1000, 0


def main(categories: tyro.conf.Positional[tuple[str, ...]], views: int = 4000) -> None:
    for name in categories:
        folder = find_weights(name)
        net = load(OmadNet, folder)
        before = Confidence.load(folder, net.category)
        if before is None:
            raise InputError(f"{folder}: tells no probability; give omad train confidence first")
        # as it is fitted: answers that are known to be improbable would be looked at again
        estimator = Estimator(net, surfaces=Surfaces.beside(folder, net.prior, net.category))
        estimator.hand, estimator.answers.asked = before.hand, before.image
        models = load_models("procedural", net.category, OBJECTS, "train", UNSEEN).models
        right, cost = fit_right(answered(estimator, models, views, SEED), before.image)
        replace(before, right=right).save(folder)
        print(f"{name}: log loss {cost:.4f} of views that are left out of a fit", flush=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
