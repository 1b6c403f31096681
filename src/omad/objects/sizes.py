"""How large objects of a category usually are, and by what depth was read wrongly where one seems to be of another
size."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from .category import Category

USUAL_SIZE = 2.5
"""Diagonal of an object's cloud in category units; 1.5 to 4 in standard views."""
ODD_SIZE = 4.0
"""A cloud so many times larger or smaller than usual is none of the category at its size."""
FACTORS = (0.001, 0.01, 0.1, 0.2, 5.0, 10.0, 100.0, 1000.0)
"""By which depth scales are wrong: millimetres for metres, tenths of millimetres or 1/5000 m for millimetres ..."""
ALIKE = {0.2: (0.2, 0.25), 5.0: (5.0, 4.0)}
"""Those that no size tells apart: data sets store 1/5000 m, and cameras 1/4 mm."""
POINT = 1e-9
"""Metres that no object is smaller than."""


def usual_size(category: Category) -> float:
    """Metres, diagonal of a cloud of it."""
    return USUAL_SIZE * category.metres_per_unit


def is_of_size(size: float, usual: float) -> bool:
    """Whether what is ``size`` metres large may be an object that usually is so large as ``usual``."""
    return usual / ODD_SIZE < size < ODD_SIZE * usual


@dataclass(frozen=True)
class WrongScale:
    """A depth scale that would explain an odd size."""

    why: str
    cure: str

    @classmethod
    def of(cls, factor: float, depth_scale: float | None) -> Self:
        """Depth has to be taken so many times; ``depth_scale``: metres per number that it was read with, where
        known."""
        units = {0.001: "millimetres read as metres", 1000.0: "metres read as millimetres"}
        factors = ALIKE.get(factor, (factor,))
        times = " or ".join(f"{max(each, 1 / each):g}" for each in factors)
        wrong = f"{times} times too {'small' if factor > 1 else 'large'}"
        scales = " or ".join(f"{(depth_scale or 1) * each:g}" for each in factors)
        cure = f"multiply the depth scale by {scales}" if depth_scale is None else f"--depth-scale {scales}"
        return cls(f"depth looks like {units.get(factor, f'lengths {wrong}')}", cure)


def wrong_scale(size: float, usual: float, depth_scale: float | None = None) -> WrongScale | None:
    """What depth must have been read wrongly by, where something is ``size`` metres large and ``usual`` is another;
    None where no common mistake explains it. ``depth_scale``: metres per number that it was read with, where known."""
    factor = min(FACTORS, key=lambda factor: abs(np.log(max(size, POINT) * factor / usual)))
    return WrongScale.of(factor, depth_scale) if is_of_size(size * factor, usual) else None
