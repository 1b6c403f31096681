"""Which category an object is of: all are tried, and ranked by how well their estimates explain what was seen.

The score is linear in the evidence; its weights were fitted to unseen views of training objects by maximum likelihood
(``benchmarks/bench_auto_category.py --fit``), the same for every category.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .estimate import Estimate
from .estimator import Estimator
from .evidence import Evidence, weigh
from .known import Known
from .observation import Observation

WEIGHTS = np.array([0.52, 2.1, 2.9, 44.0, 36.0])
"""Of the evidence, in its order; log-odds per unit."""


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
        return {
            "category": self.estimate.category.name,
            "score": round(self.score, 3),
            "probability": round(self.probability, 4),
        }


def rank(observation: Observation, estimators: Sequence[Estimator], known: Known | None = None) -> list[Candidate]:
    """Each estimator's explanation, best first."""
    estimates = [estimator(observation, known or Known()) for estimator in estimators]
    evidence = [weigh(observation, *pair) for pair in zip(estimates, estimators, strict=True)]
    scores = np.array([score(found) for found in evidence])
    odds = np.exp(scores - scores.max())
    found = map(Candidate, estimates, evidence, scores.tolist(), (odds / odds.sum()).tolist())
    return sorted(found, key=lambda candidate: -candidate.score)


def score(evidence: Evidence) -> float:
    """Log-odds of an explanation up to a constant; minus infinity where a number is missing."""
    value = -float(WEIGHTS @ evidence.values)
    return value if np.isfinite(value) else -np.inf
