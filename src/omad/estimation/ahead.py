"""Compiling ahead: an estimator answers a made-up view, so that all that is compiled on the way is compiled, and no
answer's time holds any of it."""

from collections.abc import Callable, Hashable, Sequence

import numpy as np

from omad.objects.category import Category
from omad.sensing.observation import Observation

from .estimate import Estimate

_DONE: set[Hashable] = set()
"""Of this process."""


def compile_ahead(
    answers: Callable[[Sequence[Observation]], list[Estimate]], category: Category, settings: Hashable = None
) -> None:
    """Compile, or load what an earlier process compiled, on the way from a depth image to an estimate, once a process
    and ``settings``, which are to say all that the way depends on. ``answers`` need not be compared with others, which
    takes as long again and the same code. Where something has to be compiled, a line on stderr says so."""
    if settings in _DONE:
        return
    view = made_up_view(category)
    for views in ([view], [view, view]):
        for estimate in answers(views):
            estimate.to_dict()
    _DONE.add(settings)


def made_up_view(category: Category) -> Observation:
    """A tilted square, as large and as far away as an object of the category, that a mask cuts out of a larger one."""
    unit, size, focal = category.metres_per_unit, 48, 72.0
    depth = unit * (3.0 + np.linspace(-0.3, 0.3, size)[:, None] + np.linspace(-0.5, 0.5, size))
    middle = (size - 1) / 2
    mask = np.pad(np.ones((size - 8, size - 8)), 4)
    return Observation.from_depth(depth.astype(np.float32), (focal, focal, middle, middle), mask)
