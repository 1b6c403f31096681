"""One thing to look at where a result is doubtful, and how far an answer is believed then."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..estimate import Estimate

RARELY = 0.06
"""Share of answers to spoilt views of unseen objects and of other things that are right where the surface that was
fitted to the image stays below it, too (two of 33), or where what was seen is surely of no category (13 of 195)."""


@dataclass(frozen=True)
class Check:
    """One item."""

    name: str
    """One word, the same for every such check."""
    what: str
    """What is unusual, with numbers."""
    why: str
    """What it may come from."""
    cure: str
    """What to do."""
    grave: bool = False
    """Answers of which this is said are hardly ever right (``RARELY``)."""

    def __str__(self) -> str:
        return f"{self.name}: {self.what}: {self.why}; {self.cure}"

    def to_dict(self) -> dict[str, str]:
        """For JSON: what a person reads. How grave it is, the probability says."""
        return {"name": self.name, "what": self.what, "why": self.why, "cure": self.cure}


def is_doubtful(estimate: Estimate, found: Sequence[Check]) -> bool:
    """Whether an answer is rather wrong than right: by its probability; where it has none, if something was ``found``
    to be doubtful."""
    return bool(found) if estimate.doubtful is None else estimate.doubtful


def believed(estimate: Estimate, found: Sequence[Check]) -> Estimate:
    """The estimate with no higher a probability than what was ``found`` leaves it."""
    return no_surer(estimate, RARELY) if any(check.grave for check in found) else estimate


def warned(estimate: Estimate, found: Sequence[Check]) -> Estimate:
    """The estimate with what was ``found`` among its warnings, and no surer than that leaves it."""
    if not found:
        return estimate
    return replace(believed(estimate, found), warnings=(*estimate.warnings, *map(str, found)))


def no_surer(estimate: Estimate, probability: float) -> Estimate:
    """The estimate, that it is right being no likelier than so."""
    if estimate.probability is None or estimate.probability <= probability:
        return estimate
    return replace(estimate, probability=probability)


def if_also(estimate: Estimate, probability: float) -> Estimate:
    """The estimate, that it is right only if something else is, too, of a ``probability``: as likely as their product,
    which keeps its word better than the smaller of both (``benchmarks/certainty/bench_auto_probability.py``)."""
    return no_surer(estimate, (estimate.probability or 0.0) * probability)
