"""How good rankings are, from which of the ranked things are the same object. Pure functions."""

from dataclasses import astuple, dataclass, fields

import numpy as np

CUTOFF = 10
"""Of mAP."""


@dataclass(frozen=True)
class Scores:
    """Means over queries, each in [0, 1]."""

    map_at_10: float
    """Sum over hit ranks r <= 10 of precision at r, divided by min(10, number of relevant)."""
    nearest_neighbour: float
    """Share of queries whose first answer is right."""
    first_tier: float
    """Share of the R relevant things that are among the first R."""
    second_tier: float
    """And among the first 2 R."""


def rank(distances: np.ndarray, left_out: np.ndarray | None = None) -> np.ndarray:
    """Rows of the gallery (Q, n), nearest first, by ``distances`` (Q, G); NaN is farthest. ``left_out`` (Q, G) bool:
    what is no answer, as the query itself. It is cut off: n is G less the fewest that any query leaves out; where a
    query leaves out more of them, the others stand last."""
    kept = np.where(np.isfinite(distances), distances, np.finfo(np.float64).max)
    left_out = np.zeros_like(kept, dtype=bool) if left_out is None else left_out
    order = np.argsort(np.where(left_out, np.inf, kept), axis=1, kind="stable")
    return order[:, : order.shape[1] - left_out.sum(1).min()]


def average_precision(relevant: np.ndarray) -> np.ndarray:
    """AP@10 (Q,) of ranked relevance (Q, G) bool; 0 where nothing is relevant."""
    top = relevant[:, :CUTOFF]
    precision = top.cumsum(1) / np.arange(1, top.shape[1] + 1)
    return (precision * top).sum(1) / relevant.sum(1).clip(1, CUTOFF)


def tier(relevant: np.ndarray, times: int) -> np.ndarray:
    """Share (Q,) of the R relevant things among the first ``times`` R of ranked relevance (Q, G) bool."""
    total = relevant.sum(1)
    within = np.arange(relevant.shape[1]) < times * total[:, None]
    return (relevant & within).sum(1) / np.clip(total, 1, None)


def scores(relevant: np.ndarray) -> Scores:
    """All metrics of ranked relevance (Q, G) bool; 0 where a gallery holds nothing but the query."""
    return Scores(
        map_at_10=float(average_precision(relevant).mean()),
        nearest_neighbour=float(relevant[:, :1].any(1).mean()),
        first_tier=float(tier(relevant, 1).mean()),
        second_tier=float(tier(relevant, 2).mean()),
    )


def chance(relevant: np.ndarray, rng: np.random.Generator, permutations: int = 10) -> Scores:
    """What random rankings of the same galleries reach."""
    return mean_scores([scores(rng.permuted(relevant, axis=1)) for _ in range(permutations)])


def mean_scores(several: list[Scores]) -> Scores:
    """Mean of each metric, NaN of none."""
    rows = [astuple(one) for one in several] or [[np.nan] * len(fields(Scores))]
    return Scores(*np.mean(rows, axis=0).tolist())
