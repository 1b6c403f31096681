"""Which category an object is of: all are tried, and ranked by how well their estimates explain what was seen.

The score is linear in what speaks against a category; its weights were fitted to unseen views of training objects by
maximum likelihood (``benchmarks/bench_auto_category.py --fit``), those of pixels beside the others' fixed ratios, the
same for every category.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from omad.sensing.observation import Observation

from .checks import Check
from .estimate import Estimate
from .estimator import Estimator
from .evidence import Evidence, explanation, measure_evidence
from .known import Known

LOG_ODDS = np.array([0.29, 1.2, 1.6, 25.0, 20.0, 5.7, 3.0, 9.2])
"""Per unit of what speaks ``against`` a category, in its order."""
SURE = 0.8
"""Probability from which on another category is suspected."""


def against(observation: Observation, estimate: Estimate, evidence: Evidence) -> np.ndarray:
    """(8,) the evidence, and the shares of pixels that the surface does not explain: where it is in front of what was
    seen, behind it, and missing."""
    found = explanation(observation, estimate)
    return np.append(evidence.values, [found.in_front, found.behind, found.missing])


@dataclass(frozen=True)
class Candidate:
    """One category's explanation of an observation."""

    estimate: Estimate
    evidence: Evidence
    score: float
    """Log-odds up to a constant; higher is better."""
    probability: float
    """That it is this category rather than another candidate."""

    def to_dict(self) -> dict[str, Any]:
        """Name, score and probability, as plain values."""
        name = self.estimate.category.name
        return {"category": name, "score": round(self.score, 3), "probability": round(self.probability, 4)}


def rank(observation: Observation, estimators: Sequence[Estimator], known: Known | None = None) -> list[Candidate]:
    """Each estimator's explanation, best first; without those whose answers are no numbers, as of a cloud many times
    larger than the category."""
    rows = [(estimator(observation, known or Known()), estimator.net.prior) for estimator in estimators]
    rows = [(estimate, prior) for estimate, prior in rows if estimate.is_finite]
    if not rows:
        return []
    estimates = [estimate for estimate, _ in rows]
    evidence = [measure_evidence(observation, estimate, prior) for estimate, prior in rows]
    seen = zip(estimates, evidence, strict=True)
    scores = -np.array([against(observation, estimate, found) for estimate, found in seen]) @ LOG_ODDS
    scores[~np.isfinite(scores)] = -np.inf  # where a number is missing
    odds = np.exp(scores - scores.max())
    found = map(Candidate, estimates, evidence, scores.tolist(), (odds / odds.sum()).tolist())
    return sorted(found, key=lambda candidate: -candidate.score)


def suspected(estimate: Estimate, ranked: Sequence[Candidate]) -> list[Check]:
    """The category that explains the observation much better than the estimate's own, of candidates best first."""
    if not ranked:
        return []
    best, name = ranked[0], estimate.category.name
    other = best.estimate.category.name
    if other == name or best.probability < SURE:
        return []
    what = f"{other} explains what was seen better than {name} (probability {best.probability:.2f})"
    why, cure = f"the object may be no {name}", f"try --category {other}, or --category auto"
    return [Check("category", what, why, cure)]
