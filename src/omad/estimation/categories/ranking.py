"""Which category an object is of: one look proposes a few, those are fitted, and ranked by how well their estimates
explain what was seen.

The score is linear in what speaks against a category, by how much it is more than usual where that category is right
(``usual.json``: networks differ in how sure they are, shapes in how much of them is seen), and in what the look says;
``fronts`` tell what neither can. All was fitted to unseen views of training objects and of strangers by maximum
likelihood (``benchmarks/accuracy/bench_auto_category.py --what fit``), the weights the same for every category.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import softmax

from omad.common.errors import InputError
from omad.model.proposals.network import shipped_proposer
from omad.sensing.observation import Observation

from ..checks import Check
from ..estimate import Estimate
from ..evidence import Evidence, explanation, measure_evidence
from ..known import NOTHING_KNOWN, Known
from .fronts import told_apart
from .late import AnyEstimator
from .proposals import Proposals

USUAL = Path(__file__).with_name("usual.json")
LOG_ODDS = np.array([0.46, 1.8, 1.2, 1.3, 4.2, 1.7, 1.5, 0.71])
"""Per unit of what speaks ``against`` a category, in its order."""
PROPOSED = 0.79
"""Per unit of the look's log-odds of none over a category."""
OFFSET = 1.1
"""Log-odds of a category over none where no more than usual speaks against it, and the look takes it for as likely."""
SURE = 0.8
"""Probability from which on another category is suspected, or none."""


def against(observation: Observation, estimate: Estimate, evidence: Evidence) -> np.ndarray:
    """(8,) the evidence, and the shares of pixels that the surface does not explain: where it is in front of what was
    seen, behind it, and missing."""
    found = explanation(observation, estimate)
    return np.append(evidence.values, [found.in_front, found.behind, found.missing])


@cache
def usual(name: str) -> np.ndarray:
    """(8,) what speaks ``against`` a category where it is right; the mean of others for one that was not fitted."""
    known = json.loads(USUAL.read_text(encoding="utf-8"))
    return np.array(known[name]) if name in known else np.mean(list(known.values()), axis=0)


@dataclass(frozen=True)
class Candidate:
    """One category's explanation of an observation."""

    estimate: Estimate
    """The category's answer."""
    evidence: Evidence
    """What speaks against it."""
    score: float
    """Log-odds up to a constant; higher is better."""
    probability: float
    """That it is of this category rather than of another candidate's, or of none."""

    def to_dict(self) -> dict[str, Any]:
        """Name, score and probability, as plain values."""
        name = self.estimate.category.name
        return {"category": name, "score": round(self.score, 3), "probability": round(self.probability, 4)}


@dataclass(frozen=True)
class Ranking:
    """What an observation may be of."""

    candidates: tuple[Candidate, ...]
    """Likeliest first; none where no category gives an answer."""
    none: float
    """Probability that it is of none of the categories that can be fitted."""

    @property
    def is_none(self) -> bool:
        """Whether that is likeliest."""
        return not self.candidates or self.none > self.candidates[0].probability

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"categories": [candidate.to_dict() for candidate in self.candidates], "none": round(self.none, 4)}


def rank(
    observation: Observation,
    estimators: Sequence[AnyEstimator],
    known: Known = NOTHING_KNOWN,
    always: Sequence[str] = (),
) -> Ranking:
    """Explanations by those of the estimators' categories that one look proposes, and by those that are to be fitted
    ``always``; without those whose answers are no numbers, as of a cloud many times larger than the category."""
    by_name = {estimator.category.name: estimator for estimator in estimators}
    if isinstance(always, str) or not {*always} <= by_name.keys():
        raise InputError(f"always: is {always!r}; give a list of the estimators' categories: {', '.join(by_name)}")
    [look] = shipped_proposer()([known.as_level(observation)])
    proposals = Proposals.of(look, list(by_name))
    names = dict.fromkeys([*always, *proposals.worth_fitting(list(by_name))])
    asked = [by_name[name] for name in names]
    rows = [(one.first_answers([observation], known.of(one.category))[0], one.net.prior) for one in asked]
    rows = [(estimate, prior) for estimate, prior in rows if estimate.is_finite]
    if not rows:
        return Ranking((), 1.0)
    estimates = [estimate for estimate, _ in rows]
    evidence = [measure_evidence(observation, estimate, prior) for estimate, prior in rows]
    fitted = [estimate.category.name for estimate in estimates]
    each = zip(estimates, evidence, fitted, strict=True)
    numbers = [against(observation, estimate, seen) - usual(name) for estimate, seen, name in each]
    doubts = [proposals.doubt(name) for name in fitted]
    scores = OFFSET - np.array(numbers) @ LOG_ODDS - PROPOSED * np.array(doubts)
    scores[~np.isfinite(scores)] = -np.inf  # where a number is missing
    scores = told_apart(estimates, scores)
    shares = softmax([*scores, 0.0])
    found = map(Candidate, estimates, evidence, scores.tolist(), shares[:-1].tolist())
    return Ranking(tuple(sorted(found, key=lambda candidate: -candidate.score)), float(shares[-1]))


def suspected(estimate: Estimate, ranking: Ranking) -> list[Check]:
    """What speaks against the estimate's own category: what was seen is surely of none, or another explains it much
    better."""
    name = estimate.category.name
    if ranking.none >= SURE:
        what = f"what was seen is like none of the categories (probability {ranking.none:.2f})"
        why, cure = f"the object may be no {name}", "look at estimate.png; tighten the mask, or train on such objects"
        return [Check("category", what, why, cure, grave=True)]
    best = ranking.candidates[0]
    other = best.estimate.category.name
    if other == name or best.probability < SURE:
        return []
    what = f"{other} explains what was seen better than {name} (probability {best.probability:.2f})"
    why, cure = f"the object may be no {name}", f"try --category {other}, or --category auto"
    return [Check("category", what, why, cure)]
