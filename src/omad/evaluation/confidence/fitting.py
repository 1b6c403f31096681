"""Fits a category's ``Confidence``: quantiles of the joint states' errors by the pinball loss, and the probability of a
right answer by maximum likelihood."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, softplus

from omad.common.errors import InputError
from omad.data.rendering.standard_views import true_pose
from omad.estimation.confidence.model import Confidence, FittedTo, deviations, image_inputs, joint_inputs
from omad.estimation.confidence.perceptron import FARTHEST, Perceptron, Row
from omad.estimation.confidence.signals import IMAGE, JOINT, WITHOUT_FRONT, WITHOUT_SURFACE, Signals
from omad.estimation.estimator import Estimator
from omad.estimation.looks.answers import base_std, state_std
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from ..calibration import area_under_roc, expected_calibration_error
from ..metrics import pose_errors
from .gathered import Begun, Rows, gathered
from .views import HEAPS, OTHERS, PART_MISSED, Example, examples

BATCH = 64
HIDDEN = 12
STEPS = 300
LEARNING_RATE = 0.02
DECAYS = (3e-3, 1e-2, 3e-2)
"""Of the squared weights of the hidden layer, a tenth of it for the linear function: the best of them is found ..."""
FOLDS = 3
"""... by fits that leave out a third each."""
DIGITS = 8
"""Of the fitted numbers: single precision has no more, and the file is half as long."""
SMALLEST = 1e-4
"""Added to errors before their logarithm is taken, category units or radians."""
WORTH = {WITHOUT_SURFACE: 0.03, IMAGE: 0.08}
"""What more may be asked for, and by how much smaller the log loss of what is right has to be with it: the front takes
one millisecond, the surface one or two."""
WITHIN_ONE = 0.6827
"""Of normal errors, the share below one standard deviation."""
FEWEST = 200
"""Views of the category, right and wrong ones together, that can be learned from."""

Loss = Callable[[Tensor, Tensor], Tensor]
"""Of outputs (N, k) and what was seen (N,)."""


@dataclass(frozen=True)
class JudgedAnswers:
    """What an estimator said of N views."""

    signals: Signals
    errors: np.ndarray
    """(N, J) of the joint states, category units; NaN of views of other things, and of masks that leave a part out:
    these are to be doubted, as intervals as wide as a guess would make all others wider."""
    right: np.ndarray
    """(N,) bool."""
    base: np.ndarray
    """(N, 6) how far off the base's rotation vector and translation are, in deviations by least squares; NaN as above.
    """
    least: np.ndarray
    """(N, J) radians or metres, standard deviations of the joint states by least squares."""

    @property
    def counted(self) -> np.ndarray:
        """(N,) bool, whose errors are known."""
        return ~np.isnan(self.errors[:, 0])


def check_views(views: int) -> None:
    """Raises InputError where so many views are too few for ``fit``, as some show other things."""
    share = (1 - OTHERS - HEAPS) * (1 - PART_MISSED)
    needed = math.ceil(1.1 * FEWEST / share)  # by chance they may be fewer
    if views < needed:
        said = f"views: are {views}, {share:.0%} of which show the category whole, and at least {FEWEST} must"
        raise InputError(f"{said}; give more, from {needed} on")


def answered(
    estimator: Estimator, models: Sequence[ObjectModel], views: int, seed: int, begun: Begun | None = None
) -> JudgedAnswers:
    """The estimator's answers to so many views of the ``models``, and of other things. With ``begun`` they go on."""

    def made(indices: range) -> Rows:
        return _answers(estimator, list(examples(models, estimator.category, indices, seed)))

    rows = gathered(made, views, BATCH, f"answers-{seed}", begun)
    signals = Signals(*(rows.pop(field.name) for field in fields(Signals)))
    return JudgedAnswers(signals, **rows)


def _answers(estimator: Estimator, shown: Sequence[Example]) -> Rows:
    """What ``JudgedAnswers`` and its signals hold of these views."""
    if not shown:
        return {}
    category = estimator.category
    estimates = estimator([example.observation() for example in shown])
    errors, right = np.full((len(shown), len(category.joints)), np.nan), np.zeros(len(shown), dtype=bool)
    base, covariance = np.full((len(shown), 6), np.nan), np.stack([estimate.covariance for estimate in estimates])
    for number, (example, estimate) in enumerate(zip(shown, estimates, strict=True)):
        if example.of_category and estimate.is_finite:
            truth = example.view.truth
            found = pose_errors(estimate.pose(), true_pose(example.view, category), truth.part_boxes, category)
            right[number] = found.right(category, truth.diagonal)
            if not example.part_missed:
                errors[number] = found.joint_state / category.state_units
                base[number] = base_errors(estimate.T_camera_base, example.view.T_camera_base)
    told = {"errors": errors, "right": right, "base": base / base_std(covariance)}
    told["least"] = state_std(covariance, category)
    return told | vars(Signals.joined([estimate.signals for estimate in estimates]))


def base_errors(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(6,) by what rotation vector and translation a pose (4, 4) is off, none of it negative: radians and metres."""
    turned = Rotation.from_matrix(found[:3, :3] @ true[:3, :3].T).as_rotvec()
    return np.abs(np.concatenate([turned, found[:3, 3] - true[:3, 3]]))


def fit(answers: JudgedAnswers, category: Category, fitted_to: FittedTo) -> Confidence:
    """Raises InputError where there is too little to learn from."""
    mine = answers.counted
    if mine.sum() < FEWEST:
        said = f"views: {mine.sum()} of them show the category whole"
        raise InputError(f"{said}, at least {FEWEST} are needed; give more")
    image, right, cost = WITHOUT_FRONT, *fit_right(answers, WITHOUT_FRONT)
    for level, worth in WORTH.items():
        more, less = fit_right(answers, level)
        if less < (1 - worth) * cost:
            image, right, cost = level, more, less
    inputs = joint_inputs(answers.signals.known_by(image))[mine]
    errors = fit_errors(inputs, answers.errors[mine])
    found = Confidence(category.name, image, JOINT, errors, right, fitted_to)
    return replace(found, base=base_multiples(found, answers, category))


def base_multiples(confidence: Confidence, answers: JudgedAnswers, category: Category) -> tuple[float, float]:
    """``Confidence.base``: such that as many errors are below one deviation as of normal ones."""
    turned, moved = np.nanquantile(_base_off(confidence, answers, category), WITHIN_ONE, axis=(0, 2)).round(3).tolist()
    return turned, moved


def _base_off(confidence: Confidence, answers: JudgedAnswers, category: Category) -> np.ndarray:
    """(N, 2, 3) the errors of the base's rotation and translation in views of the category, in deviations."""
    told, _ = confidence.spreads(answers.signals, category)
    off = answers.base / confidence.base_spreads(np.ones((len(told), 6)), answers.least, told)
    return off[answers.counted].reshape(-1, 2, 3)


def measured(confidence: Confidence, answers: JudgedAnswers, category: Category) -> dict[str, Any]:
    """How well it keeps its word on ``answers``: shares of joint states in their intervals and of errors of the base
    below one deviation, and of the probability."""
    mine, told = answers.counted, confidence.probabilities(answers.signals)
    std, tail = confidence.spreads(answers.signals, category)
    errors = answers.errors[mine] * category.state_units
    within = {level: std[mine] * deviations(level) ** tail[mine] for level in (0.5, 0.9)}
    covered = {f"covered_{100 * level:.0f}": float((errors <= half).mean()) for level, half in within.items()}
    base = (_base_off(confidence, answers, category) < 1).mean((0, 2)).tolist()
    covered |= dict(zip(("rotation_covered_68", "translation_covered_68"), base, strict=True))
    error, area = expected_calibration_error(told, answers.right), area_under_roc(told, answers.right)
    return covered | {"right": float(answers.right.mean()), "calibration_error": error, "area_under_roc": area}


def fit_errors(inputs: np.ndarray, errors: np.ndarray) -> Perceptron:
    """``Confidence.errors`` from ``inputs`` (N, J, n) and ``errors`` (N, J), none negative. In views that it was not
    fitted to answers are farther off than in those that it was: by how much is told by fits without them."""
    seen, view = np.log(errors + SMALLEST).ravel(), np.repeat(np.arange(len(errors)), errors.shape[1])
    rows = inputs.reshape(len(seen), -1)
    found, said = _cross_validated(rows, seen, view, _quantile_loss, [float(np.median(seen)), 0.5])
    farther = np.median(seen - said[:, 0])
    above = np.maximum(seen - said[:, 0] - farther, 0)
    with np.errstate(divide="ignore"):
        wider = np.quantile(np.log(np.expm1(above)) - said[:, 1], 0.9)  # where softplus gives the 90th percentile
    median, ratio = found.straight
    straight = (*median[:-1], median[-1] + float(farther)), (*ratio[:-1], ratio[-1] + float(wider))
    return replace(found, straight=straight)


def fit_right(answers: JudgedAnswers, image: tuple[str, ...]) -> tuple[Perceptron, float]:
    """``Confidence.right`` by so much of ``IMAGE``, and its mean log loss on what is left out of a fit."""
    inputs, right = image_inputs(answers.signals.known_by(image)), answers.right
    share = (right.sum() + 1) / (len(right) + 2)
    view = np.arange(len(right))
    found, said = _cross_validated(inputs, right, view, _log_loss, [math.log(share / (1 - share))])
    return found, float(_log_loss(torch.as_tensor(said), torch.as_tensor(right, dtype=torch.float64)))


def _quantile_loss(said: Tensor, logs: Tensor) -> Tensor:
    median = said[:, 0]
    return (_pinball(logs - median, 0.5) + _pinball(logs - median - softplus(said[:, 1]), 0.9)).mean()


def _pinball(above: Tensor, level: float) -> Tensor:
    """Least where a share ``level`` of the numbers is below zero."""
    return torch.maximum(level * above, (level - 1) * above)


def _log_loss(said: Tensor, right: Tensor) -> Tensor:
    return binary_cross_entropy_with_logits(said[:, 0], right)


def _cross_validated(
    inputs: np.ndarray, seen: np.ndarray, view: np.ndarray, loss: Loss, start: Sequence[float]
) -> tuple[Perceptron, np.ndarray]:
    """A fit to inputs (N, n) and what was ``seen`` (N,) in each ``view`` (N,), with the decay that does best on views
    that are left out of a fit; and what fits with that decay say (N, len(start)) of those left out of them."""
    fold, targets = view % FOLDS, torch.as_tensor(seen, dtype=torch.float32)
    lowest, best, kept = math.inf, DECAYS[0], np.empty((len(seen), len(start)))
    for decay in DECAYS:
        said = np.empty_like(kept)
        for number in range(FOLDS):
            rest = fold != number
            said[~rest] = _fitted(inputs[rest], targets[torch.as_tensor(rest)], loss, start, decay)(inputs[~rest])
        cost = float(loss(torch.as_tensor(said, dtype=torch.float32), targets))
        if cost < lowest:
            lowest, best, kept = cost, decay, said
    return _fitted(inputs, targets, loss, start, best), kept


def _fitted(inputs: np.ndarray, targets: Tensor, loss: Loss, start: Sequence[float], decay: float) -> Perceptron:
    """Of inputs (N, n), with the smallest ``loss`` of its outputs (N, len(start)), which begin at ``start``."""
    mean, spread = inputs.mean(0), np.maximum(inputs.std(0), 1e-6)
    x = torch.as_tensor(((inputs - mean) / spread).clip(-FARTHEST, FARTHEST), dtype=torch.float32)
    generator, (n, outputs) = torch.Generator().manual_seed(0), (x.shape[1], len(start))
    hidden = nn.Parameter(torch.randn(HIDDEN, n + 1, generator=generator) / math.sqrt(n))
    bent = nn.Parameter(torch.randn(outputs, HIDDEN, generator=generator) * 0.1 / math.sqrt(HIDDEN))
    straight = nn.Parameter(torch.cat([torch.zeros(outputs, n), torch.tensor(start)[:, None]], 1))
    optimiser = torch.optim.Adam([hidden, bent, straight], LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    for _ in range(STEPS):
        said = torch.tanh(x @ hidden[:, :-1].T + hidden[:, -1]) @ bent.T + x @ straight[:, :-1].T + straight[:, -1]
        size = hidden[:, :-1].square().sum() + bent.square().sum() + 0.1 * straight[:, :-1].square().sum()
        optimiser.zero_grad()
        (loss(said, targets) + decay * size).backward()
        optimiser.step()
        schedule.step()
    rows = (tuple(map(_short, weights.detach())) for weights in (hidden, bent, straight))
    return Perceptron(_short(mean), _short(spread), *rows)


def _short(row: Tensor | np.ndarray) -> Row:
    return tuple(float(f"{value:.{DIGITS}g}") for value in row.tolist())
