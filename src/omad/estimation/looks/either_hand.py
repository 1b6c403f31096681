"""Objects that may be of either hand: which of two answers counts, that of the view or that of its mirror image."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..estimate import Estimate


def surer_hands(plain: Sequence[Estimate], mirrored: Sequence[Estimate], together: bool) -> list[Estimate]:
    """Of each two answers to an observation the one that expects the smaller errors of its keypoints; of all views
    ``together`` where they show one object. Both take their time."""
    expected = np.array([[_log_error(estimate) for estimate in estimates] for estimates in (plain, mirrored)])
    if together:
        expected = np.broadcast_to(expected.mean(1, keepdims=True), expected.shape)
    chosen = [pair[int(row.argmin())] for pair, row in zip(zip(plain, mirrored, strict=True), expected.T, strict=True)]
    seconds = [_added(pair) for pair in zip(plain, mirrored, strict=True)]
    return [replace(estimate, seconds=spent) for estimate, spent in zip(chosen, seconds, strict=True)]


def _log_error(estimate: Estimate) -> float:
    """Of the keypoints' expected errors, the logarithm of the geometric mean."""
    return float(np.log(estimate.keypoint_std).mean())


def _added(pair: Sequence[Estimate]) -> dict[str, float]:
    return {key: sum(estimate.seconds[key] for estimate in pair) for key in pair[0].seconds}
