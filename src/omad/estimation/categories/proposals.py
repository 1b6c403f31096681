"""What one look of the shared network says of the categories that can be fitted, and which of them are worth it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Self

from omad.model.checkpoint import shipped_categories

MOST = 5
"""Categories that are fitted, at most, ..."""
ENOUGH = 0.995
"""... or fewer, where these are so likely together among all that can be: a look takes one for its like too easily."""
UNKNOWN = 0.05
"""Probability of a category that the look does not know, as one of a user's own."""
LEAST = 1e-4
"""Probability of anything."""
UNASKED = 0.01
"""As how many times as likely as the look has it a category with weights counts that was not asked for: who names
categories knows what may be there, as a look does not, which takes one for its like."""


@dataclass(frozen=True)
class Proposals:
    """Probabilities, one look's."""

    shares: Mapping[str, float]
    """Of the categories that can be fitted and that the look knows, likeliest first."""
    none: float
    """Of all others, and of things that are of none."""

    @classmethod
    def of(cls, look: Mapping[str | None, float], names: Sequence[str]) -> Self:
        """``look``: as a ``Proposer`` gives it; ``names``: of the categories that can be fitted."""
        unasked = _with_weights() - set(names)
        odds = {name: share * (UNASKED if name in unasked else 1) for name, share in look.items()}
        total = sum(odds.values())
        shares = {name: one / total for name, one in odds.items() if name is not None and name in names}
        return cls(shares, max(1 - sum(shares.values()), 0.0))

    def doubt(self, name: str) -> float:
        """Log-odds of none of the categories that can be fitted over this one."""
        return math.log(max(self.none, LEAST) / max(self.shares.get(name, UNKNOWN), LEAST))

    def worth_fitting(self, names: Sequence[str]) -> list[str]:
        """Of these the likeliest few, and all that the look does not know."""
        known = [name for name in self.shares if name in names]
        total, before, chosen = sum(self.shares[name] for name in known), 0.0, list[str]()
        for name in known[:MOST]:
            if before < ENOUGH * total:
                chosen.append(name)
            before += self.shares[name]
        return chosen + [name for name in names if name not in self.shares]


@cache
def _with_weights() -> frozenset[str]:
    return frozenset(shipped_categories())
