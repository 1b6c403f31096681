"""NumPy from whatever a caller has."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch import Tensor


def as_numpy(values: Any) -> np.ndarray:
    """NumPy array of anything array-like; a tensor may be on any device and have a gradient."""
    return values.detach().cpu().numpy() if isinstance(values, Tensor) else np.asarray(values)


def as_doubles(tensor: Tensor) -> np.ndarray:
    """Contiguous float64 array, as compiled loops want it."""
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), dtype=np.float64)
