"""Categories between which a quick look and quick fits leave a doubt, as between chests of four and of five drawers.

The surface of each is fitted to what was seen, and the one that comes nearest counts more.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from omad.model.surfaces.agreement import Overlay
from omad.sensing.observation import Observation

from ..estimate import Estimate

RIVAL = 0.2
"""Probability from which on a category is a rival of the likeliest, as a share of its."""
MOST = 3
"""Rivals, the likeliest one with them: a surface takes as long as an answer."""
NEARER = 16.0
"""Log-odds of one rival over another by how much nearer its surface is."""


def told_apart(observation: Observation, estimates: Sequence[Estimate], scores: np.ndarray) -> np.ndarray:
    """``scores`` (C,), log-odds of the estimates' categories, of which rivals were told apart; what they have together
    is as before. All as they were where there are none, or one whose weights have no surfaces. Raises InputError where
    these cannot be read."""
    rivals = rivals_of(estimates, scores)
    if len(rivals) < 2:
        return scores
    near = [nearness(observation, estimates[i]) for i in rivals]
    told, before = scores.copy(), scores[rivals]
    told[rivals] = before + NEARER * np.array(near)
    told[rivals] += logsumexp(before) - logsumexp(told[rivals])
    return told


def rivals_of(estimates: Sequence[Estimate], scores: np.ndarray) -> list[int]:
    """Which estimates have to be told apart, likeliest first; none where that cannot be."""
    likely = np.argsort(-scores)[:MOST].tolist()
    rivals = [i for i in likely if np.isfinite(scores[i]) and scores[i] >= scores[likely[0]] + np.log(RIVAL)]
    return rivals if all(estimates[i].surfaces is not None for i in rivals) else []


def nearness(observation: Observation, estimate: Estimate) -> float:
    """Of the estimate's surface, fitted, to what was seen: ``Overlay.nearness``."""
    return Overlay.of(estimate.surface.posed(), observation).nearness
