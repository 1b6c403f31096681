"""Objects that may be of either hand: which of two answers counts, that of the view or that of its mirror image."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit, logit

from omad.common.arrays import number
from omad.common.errors import InputError
from omad.model.fronts.hands import shipped_hand_net
from omad.model.fronts.seen import front_of

from ..checks import hand_doubts
from ..confidence.model import CURE, FILE
from ..estimate import Estimate, total_seconds
from .relief import as_shut, relief

FRONTS = 2
"""Numbers that the front says: as of an open door, and as of a shut one."""


def surer_hands(
    plain: Sequence[Estimate],
    images: Sequence[Estimate],
    hand: Sequence[float],
    together: bool,
    mirrored_probability: float | None = None,
) -> list[Estimate]:
    """Of each two answers, to an observation and to its mirror image, the one whose object is likelier of the
    category's hand, as ``odds`` tells, with how likely that is; or where there is no ``hand``, the one that expects the
    smaller errors of its keypoints. Of all views ``together`` where they show one object. ``mirrored_probability`` is
    what was known before, as of ``Known``. Both take their time."""
    pairs = list(zip(plain, images, strict=True))
    odds_for = np.array([[_for(estimate, hand) for estimate in pair] for pair in pairs])
    if together:
        odds_for[:] = odds_for.mean(0)
    # either answer tells the odds, for itself and against the other: the mean of both
    lead = (odds_for[:, 0] - odds_for[:, 1]) / 2
    if mirrored_probability is not None:
        before = -logit(number(mirrored_probability))
        surely = np.abs(lead) if hand else np.zeros(len(lead))  # expected errors are no odds: what was known counts
        lead = np.where(surely >= abs(before), lead, before)
    chosen = [own if ahead >= 0 else image.in_mirror() for ahead, (own, image) in zip(lead, pairs, strict=True)]
    told = expit(np.abs(lead)).tolist() if hand else [None] * len(pairs)
    return [
        _with(estimate, total_seconds(pair), probability)
        for estimate, pair, probability in zip(chosen, pairs, told, strict=True)
    ]


def _with(estimate: Estimate, seconds: dict[str, float], probability: float | None) -> Estimate:
    warnings = (*estimate.warnings, *map(str, hand_doubts(probability)))
    return replace(estimate, seconds=seconds, hand_probability=probability, warnings=warnings)


def odds(hand: Sequence[float], estimate: Estimate) -> float:
    """Log-odds that an object is of the category's hand and not its mirror image: ``hand`` is a linear function of
    what ``told`` says, its constant last; or of all but what the front says, where it was fitted before that was asked.
    Raises InputError where it is of another backbone."""
    known = told(estimate)
    if len(hand) - 1 not in (len(known), len(known) - FRONTS):
        raise InputError(f"{FILE}: field hand: of another network; {CURE}")
    return float(known[: len(hand) - 1] @ np.array(hand[:-1]) + hand[-1])


def told(estimate: Estimate) -> np.ndarray:
    """(K,) what tells the hand: what the backbone knows of the cloud; how far up in the image the answer's own up
    points, as a door hinged at the right is one hinged at the left where the object stands on its head; where on a shut
    door things stand out, as little else tells where its hinge is; and what a network says that sees the front."""
    category, placed = estimate.category, estimate.placed
    known = np.append(estimate.signals.pooled[0], -estimate.T_camera_base[1, 1])
    front = shipped_hand_net().says(front_of(estimate, category, estimate.labelled.points), category.name)
    if not category.turning[0]:
        return np.append(known, [front, 0.0])
    out = relief(
        estimate.labelled.points, estimate.keypoints, category.part_of_keypoint, placed.T_camera_part,
        placed.axes[0], placed.pivots[0], category.metres_per_unit,
    )  # fmt: skip
    return as_shut(known, front, float(estimate.joint_states[0]), out)


def _for(estimate: Estimate, hand: Sequence[float]) -> float:
    return odds(hand, estimate) if hand else -math.log(estimate.expected_error)
