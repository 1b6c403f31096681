"""Views that are spoilt in few ways or in many: what a share is learned from that has to hold in all of them."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TypeVar

import numpy as np

from omad.objects.category import Category
from omad.objects.model import ObjectModel

from ..standard_views import View
from .scenes import draw_scene
from .spoil import Spoil, Staging, random_spoil
from .spoiling import spoilt, within_range

WAVES = (0.002, 0.03)
"""Smooth depth error as a share of the object's diagonal."""
FEWEST = 500
"""Points of a cloud that is thinned out."""

STREAM = 1
"""Behind a view's seed, random numbers of the spoil's own: the view's would tie the one to the other."""

Setting = TypeVar("Setting", Spoil, Staging)


def thinned_spoil(rng: np.random.Generator) -> Spoil:
    """A random spoil of which a random share is left: from nothing wrong to all that may be."""
    every = replace(random_spoil(rng), waves=float(rng.uniform(*WAVES)))
    share = rng.random()
    return replace(_thinned(every, share, rng), staging=_thinned(every.staging, share, rng))


def thinly_spoilt(model: ObjectModel, category: Category, seed: Sequence[int]) -> View | None:
    """A scene of ``model`` with such a spoil, the same for the same ``seed``; None where the object is farther off or
    nearer than the spoil's camera works. Raises InputError for an object that is too thin or too small to be seen."""
    spoil = thinned_spoil(np.random.default_rng((*seed, STREAM)))
    scene = draw_scene(model, category, seed, spoil.staging)
    return spoilt(scene, spoil).view if within_range(scene, spoil) else None


def _thinned(settings: Setting, share: float, rng: np.random.Generator) -> Setting:
    left_out = {field.name: field.default for field in fields(settings) if rng.random() > share}
    return replace(settings, **left_out)


def some_points(count: int, rng: np.random.Generator) -> np.ndarray:
    """Which of so many points are left of a cloud that someone has thinned out: all, or as few as ``FEWEST``."""
    return rng.permutation(count)[: int(np.exp(rng.uniform(np.log(min(FEWEST, count)), np.log(count))))]
