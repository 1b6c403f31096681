"""Which of two mirror images an object is: learned from what a network makes of views of both."""

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from omad.common.batches import batched, progress
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import View, standard_view, true_pose
from omad.data.variation import nearly_at_rest
from omad.estimation.estimator import Estimator
from omad.estimation.known import Known
from omad.estimation.looks.either_hand import told
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from ..metrics import pose_errors
from .views import APART, examples

BATCH = 32
DECAY = 3e-3
"""Of the squared weights."""


def fit_hand(estimator: Estimator, models: Sequence[ObjectModel], views: int, seed: int) -> tuple[float, ...]:
    """``Confidence.hand`` of a category whose objects may be of either hand, from so many views of the ``models``, each
    with its mirror image."""
    known, right = list[np.ndarray](), list[bool]()
    spoilt = (one.view for one in examples(models, estimator.category, views // 2, seed) if one.of_category)
    for some in batched(progress(chain(spoilt, _shut(models, estimator.category, views // 2, seed)), None), BATCH):
        both = estimator.of_each_hand([view.observation() for view in some], Known())
        for view, *pair in zip(some, *both, strict=True):
            truth = true_pose(view, estimator.category)
            for estimate, posed in zip(pair, (pair[0], pair[1].in_mirror()), strict=True):
                found = pose_errors(posed.pose(), truth, view.truth.part_boxes, estimator.category)
                known.append(told(estimate))
                right.append(not found.flipped and bool((found.axis < np.pi / 2).all()))
    return logistic(np.stack(known), np.array(right))


def _shut(models: Sequence[ObjectModel], category: Category, views: int, seed: int) -> Iterator[View]:
    """So many views of the ``models``, nearly at rest and not spoilt: there a hand is hard to tell, and only what is
    well seen tells it."""
    for index in range(views):
        model = nearly_at_rest(models[index % len(models)], np.random.default_rng((seed, index)))
        yield standard_view(model, category, (seed, index, APART), ON)


def logistic(inputs: np.ndarray, true: np.ndarray) -> tuple[float, ...]:
    """Linear function of inputs (N, n), its constant last, that gives the log-odds of what is ``true`` (N,), by
    maximum likelihood with small weights."""
    mean, spread = inputs.mean(0), np.maximum(inputs.std(0), 1e-6)
    x = np.column_stack([(inputs - mean) / spread, np.ones(len(inputs))])
    sign = np.where(true, 1.0, -1.0)

    def cost(weights: np.ndarray) -> tuple[float, np.ndarray]:
        margin = sign * (x @ weights)
        slope = -(sign * expit(-margin)) @ x / len(x)
        return np.logaddexp(0, -margin).mean() + DECAY * weights @ weights, slope + 2 * DECAY * weights

    found = minimize(cost, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B").x
    weights = found[:-1] / spread
    return (*weights.tolist(), float(found[-1] - weights @ mean))
