"""Objects that may be of either hand: which of two answers counts, that of the view or that of its mirror image."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from omad.common.errors import InputError

from ..confidence.model import CURE, FILE
from ..estimate import Estimate


def surer_hands(
    plain: Sequence[Estimate], images: Sequence[Estimate], hand: Sequence[float], together: bool
) -> list[Estimate]:
    """Of each two answers, to an observation and to its mirror image, the one whose object is likelier of the
    category's hand, as ``odds`` tells, or where there is no ``hand``, the one that expects the smaller errors of its
    keypoints; of all views ``together`` where they show one object. Both take their time."""
    pairs = list(zip(plain, images, strict=True))
    odds_for = np.array([[_for(estimate, hand) for estimate in pair] for pair in pairs])
    if together:
        odds_for[:] = odds_for.mean(0)
    sides = odds_for.argmax(1)
    chosen = [image.in_mirror() if side else own for side, (own, image) in zip(sides, pairs, strict=True)]
    return [replace(estimate, seconds=_added(pair)) for estimate, pair in zip(chosen, pairs, strict=True)]


def odds(hand: Sequence[float], estimate: Estimate) -> float:
    """Log-odds that an object is of the category's hand and not its mirror image: ``hand`` is a linear function of
    what ``told`` says, its constant last. Raises InputError where it is of another backbone."""
    known = told(estimate)
    if len(hand) != len(known) + 1:
        raise InputError(f"{FILE}: field hand: of another network; {CURE}")
    return float(known @ np.array(hand[:-1]) + hand[-1])


def told(estimate: Estimate) -> np.ndarray:
    """(pooled + 1,) what tells the hand: what the backbone knows of the cloud, and how far up in the image the answer's
    own up points, as a door hinged at the right is one hinged at the left where the object stands on its head."""
    return np.append(estimate.signals.pooled[0], -estimate.T_camera_base[1, 1])


def _for(estimate: Estimate, hand: Sequence[float]) -> float:
    return odds(hand, estimate) if hand else -float(np.log(estimate.keypoint_std).mean())


def _added(pair: Sequence[Estimate]) -> dict[str, float]:
    return {key: sum(estimate.seconds[key] for estimate in pair) for key in pair[0].seconds}
