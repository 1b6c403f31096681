"""How far answers go from what their keypoints say towards what the fit to their surface says.

A known object's surface is never quite the one that is seen, so that the fit to it errs, too, but otherwise than
keypoints do: best is often a way between. How far, is found for each checkpoint on views of objects that its network
has not seen (``omad train surface``), and kept with its bank.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from omad.common.decode import Shape

NAMES = ("shares", "share_errors", "share_views")
"""Of a bank's arrays."""


@dataclass(frozen=True)
class Shares:
    """Of base and shape, and of each of J joint states."""

    taken: np.ndarray
    """(1 + J,) of the way, 0 to 1; 0 where the keypoints' answer is as good as any."""
    errors: np.ndarray
    """(3, 1 + J) mean errors that they were found by: of the keypoints' answers, of the fits', of those so far between.
    Radians of joints that turn, category units of others; of the base how far the object's ends are off, category
    units."""
    views: int
    """That they are the means over."""

    @property
    def shrinkage(self) -> np.ndarray:
        """(1 + J,) by which errors shrink."""
        return self.errors[2] / np.maximum(self.errors[0], 1e-12)

    def of_unknowns(self, each: np.ndarray, size: int) -> np.ndarray:
        """Numbers (1 + J,) of base and joints as those (P,) of ``size`` unknowns, in the order of ``State``."""
        base, joints = each[:1], each[1:]
        return np.concatenate([base.repeat(6), joints, base.repeat(size - 6 - len(joints))])

    def arrays(self) -> dict[str, Any]:
        """As a bank keeps them."""
        return dict(zip(NAMES, (self.taken, self.errors, np.array(self.views)), strict=True))

    @classmethod
    def among(cls, arrays: dict[str, np.ndarray], joints: int) -> Self | None:
        """Those of a bank's ``arrays``, if any. Raises ValueError."""
        if NAMES[0] not in arrays:
            return None
        taken, errors = Shape(1 + joints).array(arrays[NAMES[0]]), Shape(3, 1 + joints).array(arrays[NAMES[1]])
        if ((taken < 0) | (taken > 1)).any() or (errors < 0).any():
            raise ValueError(f"{NAMES[0]}: shares are from 0 to 1, and {NAMES[1]} not below 0")
        return cls(taken, errors, int(arrays[NAMES[2]]))
