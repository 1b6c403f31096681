"""Answers that are improbable, as where one side of an object was taken for another: others begin in frames turned by
quarters about the upright, one with other choices of the points, and the most probable counts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logit

from omad.geometry.transforms import quarter_turns

from ..estimate import Estimate

IMPROBABLE = 0.7
"""Probability below which others are asked for."""
CLEARLY = 1.0
"""Log-odds by which another answer must be ahead to count; when any lead counted, as many answers became wrong as were
righted ..."""
UNSURER = 0.3
"""... and by which the errors that it expects of its keypoints may be larger, logarithm."""
TURNS = quarter_turns()[1::3].double().numpy()
"""(3, 4, 4)."""


def is_improbable(estimate: Estimate) -> bool:
    """Whether others are to be asked for; not of one without a probability, and of one that is no answer."""
    return estimate.is_finite and _probability(estimate) < IMPROBABLE


def turned_frames(estimate: Estimate) -> np.ndarray:
    """(3, 4, 4) T_camera_base, metres, that three others begin in."""
    return estimate.T_camera_base @ TURNS


def likelier(estimate: Estimate, others: Sequence[Estimate]) -> Estimate:
    """The most probable of the ``others`` if it is clearly ahead, or else the estimate; with the time that all took."""
    sure = [one for one in others if one.is_finite and _expected(one) < _expected(estimate) + UNSURER]
    best = max(sure, key=_probability, default=estimate)
    ahead = logit(_probability(best)) - logit(_probability(estimate))
    seconds = {key: sum(each.seconds[key] for each in (estimate, *others)) for key in estimate.seconds}
    return replace(best if ahead > CLEARLY else estimate, seconds=seconds)


def _probability(estimate: Estimate) -> float:
    return 1.0 if estimate.probability is None else estimate.probability


def _expected(estimate: Estimate) -> float:
    """Logarithm of the errors that the network expects of its keypoints."""
    return float(np.log(estimate.keypoint_std).mean())
