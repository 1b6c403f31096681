"""Whether probabilities keep their word, and tell right from wrong."""

import numpy as np

BINS = 10


def expected_calibration_error(probabilities: np.ndarray, right: np.ndarray) -> float:
    """Mean difference between the share of answers that are ``right`` (N,) bool and what their ``probabilities`` (N,)
    say, over ten bins of equal width."""
    which = np.minimum((probabilities * BINS).astype(int), BINS - 1)
    off = np.bincount(which, probabilities - right, BINS)
    return float(np.abs(off).sum() / len(right))


def area_under_roc(probabilities: np.ndarray, right: np.ndarray) -> float:
    """Probability that a right answer has a higher one than a wrong answer; ties count half. NaN where there are only
    right or only wrong ones."""
    rights, wrongs = np.sort(probabilities[right]), np.sort(probabilities[~right])
    if not len(rights) or not len(wrongs):
        return float("nan")
    below, up_to = (np.searchsorted(wrongs, rights, side) for side in ("left", "right"))
    return float((below + up_to).mean() / (2 * len(wrongs)))
