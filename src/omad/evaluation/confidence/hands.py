"""Which of two mirror images an object is: learned from what a network makes of views of both."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import View, standard_view, true_pose
from omad.data.variation import nearly_at_rest
from omad.estimation.estimator import Estimator
from omad.estimation.known import Known
from omad.estimation.looks.either_hand import told
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from ..metrics import pose_errors
from .gathered import Begun, Rows, gathered
from .views import APART, examples

BATCH = 32
DECAY = 3e-3
"""Of the squared weights."""


def fit_hand(
    estimator: Estimator, models: Sequence[ObjectModel], views: int, seed: int, begun: Begun | None = None
) -> tuple[float, ...]:
    """``Confidence.hand`` of a category whose objects may be of either hand, from so many views of the ``models``, each
    with its mirror image. With ``begun`` it goes on."""
    category = estimator.category

    def spoilt(indices: range) -> Rows:
        shown = examples(models, category, indices, seed)
        return _of_each_hand(estimator, [one.view for one in shown if one.of_category])

    def shut(indices: range) -> Rows:
        return _of_each_hand(estimator, [_shut(models, category, (seed, index)) for index in indices])

    both = [gathered(made, views // 2, BATCH, f"{made.__name__}-{seed}", begun) for made in (spoilt, shut)]
    known, right = (np.concatenate([rows[name] for rows in both]) for name in ("known", "right"))
    return logistic(known.reshape(-1, known.shape[-1]), right.ravel())


def _of_each_hand(estimator: Estimator, views: Sequence[View]) -> Rows:
    """Of V views, each answered by an object and by its mirror image: what is ``known`` (V, 2, K) of these answers, and
    whether they are ``right`` (V, 2)."""
    if not views:
        return {}
    known, right = list[list[np.ndarray]](), list[list[bool]]()
    answers = estimator.of_each_hand([view.observation() for view in views], Known())
    for view, *pair in zip(views, *answers, strict=True):
        truth, boxes = true_pose(view, estimator.category), view.truth.part_boxes
        posed = (pair[0].pose(), pair[1].in_mirror().pose())
        errors = [pose_errors(pose, truth, boxes, estimator.category) for pose in posed]
        known.append([told(estimate) for estimate in pair])
        right.append([not found.flipped and bool((found.axis < np.pi / 2).all()) for found in errors])
    return {"known": np.array(known), "right": np.array(right)}


def _shut(models: Sequence[ObjectModel], category: Category, seed: tuple[int, int]) -> View:
    """One of the ``models``, nearly at rest and not spoilt: there a hand is hard to tell, and only what is well seen
    tells it."""
    model = nearly_at_rest(models[seed[1] % len(models)], np.random.default_rng(seed))
    return standard_view(model, category, (*seed, APART), ON)


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
