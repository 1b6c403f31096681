"""Answers that are improbable, as where one side of an object was taken for another: others begin in frames turned by
quarters about the upright, and with other choices of the points, and the most probable counts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit, logit

from omad.geometry.transforms import quarter_turns

from ..estimate import Estimate, total_seconds

IMPROBABLE = 0.7
"""Probability below which others are asked for."""
CLEARLY = 1.0
"""Log-odds by which another answer must be ahead to count; when any lead counted, as many answers became wrong as were
righted ..."""
LUCK = 0.8
"""... and those that it loses then: the most probable of several is right less often than it says."""
UNSURER = 1.35
"""How many times larger the errors that it expects of its keypoints may be."""
TURNS = quarter_turns()[[1, 7, 4]].double().numpy()
"""(3, 4, 4): a quarter to either side, and half."""


def is_improbable(estimate: Estimate) -> bool:
    """Whether others are to be asked for; not of one without a probability, and of one that is no answer."""
    return estimate.is_finite and estimate.supposed_probability < IMPROBABLE


def turned_frames(estimate: Estimate) -> np.ndarray:
    """(2 or 3, 4, 4) T_camera_base, metres, that others begin in. Half a turn is left out where standard views are from
    all around: first looks, too, know the back there, and what is gained is less than what is spoilt."""
    all_around = estimate.category.views.azimuth >= np.pi
    return estimate.T_camera_base @ (TURNS[:2] if all_around else TURNS)


def likelier(estimate: Estimate, others: Sequence[Estimate]) -> Estimate:
    """The most probable of the ``others`` if it is clearly ahead, or else the estimate; with the time that all took."""
    sure = [one for one in others if one.is_finite and one.expected_error < UNSURER * estimate.expected_error]
    best = max(sure, key=lambda one: one.supposed_probability, default=estimate)
    log_odds = float(logit(best.supposed_probability))
    seconds = total_seconds((estimate, *others))
    if log_odds <= logit(estimate.supposed_probability) + CLEARLY:
        return replace(estimate, seconds=seconds)
    return replace(best, probability=float(expit(log_odds - LUCK)), seconds=seconds)
