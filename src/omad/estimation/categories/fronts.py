"""Categories that one look and quick fits leave in doubt, told apart by the object's front: how many drawers there are,
say, or doors."""

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp, softmax

from omad.model.fronts.network import FrontNet, shipped_front_net
from omad.model.fronts.seen import front_of

from ..estimate import Estimate

FRONT = 0.87
"""How much the front counts: per unit of its log-odds of one category over another."""


def told_apart(estimates: Sequence[Estimate], scores: np.ndarray, net: FrontNet | None = None) -> np.ndarray:
    """``scores`` (C,), log-odds of the estimates' categories, with what the front says of those that the ``net``
    knows (default: the shipped one); what these have together is as before, as a front tells nothing of other things.
    """
    net = net or shipped_front_net()
    known = [i for i in range(len(scores)) if np.isfinite(scores[i]) and estimates[i].category.name in net.names]
    if len(known) < 2:
        return scores
    told, before = scores.copy(), scores[known]
    told[known] += FRONT * front_says([estimates[i] for i in known], before, net)
    told[known] += logsumexp(before) - logsumexp(told[known])
    return told


def front_says(estimates: Sequence[Estimate], scores: np.ndarray, net: FrontNet) -> np.ndarray:
    """(C,) logarithm of the probability of each of the estimates' categories by the object's front. Where that is, they
    do not all agree: each counts by how likely it is, as its log-odds in ``scores`` (C,) say, and by how much is seen
    of the front where it has it. Zeros where nothing is."""
    images = np.stack([front_of(each, each.category, each.labelled.points) for each in estimates])
    counts = softmax(scores) * images[:, 0].mean((1, 2))
    if not counts.any():
        return np.zeros(len(scores))
    columns = [net.names.index(estimate.category.name) for estimate in estimates]
    return np.asarray(logsumexp(net.says(images)[:, columns], axis=0, b=counts[:, None] / counts.sum()))
