"""Procedural object models: endless, seeded, at real sizes, free of other people's data.

A module that is called like a shipped category is its generator.
"""

from importlib import import_module
from pkgutil import iter_modules
from typing import Literal

import numpy as np

from omad.common.errors import InputError
from omad.objects.builtin import builtin_names
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .shapes import JointedParts

GENERATORS = tuple(module.name for module in iter_modules(__path__) if module.name in builtin_names())
"""Categories that have one: ``<name>.generate(rng, category, unusual) -> JointedParts``. For an unusual member of the
category, where there are such, ``unusual`` has random numbers, else it is None."""
_STREAMS = {"train": 0, "test": 1, "unusual": 2}
UNUSUAL = 0.15
"""Share of the objects to train on that are unusual, where a category has such members."""


def generate(
    category: Category, index: int, split: Literal["train", "test", "unusual"] = "train", seed: int = 0
) -> ObjectModel:
    """Object ``index`` of a category; the same for the same arguments, and never shared between splits. ``"unusual"``
    are unusual members alone, as a share of those to train on is and none of ``"test"``: results on that one stay
    comparable while families grow.

    ``seed`` and ``index`` are 32-bit. Raises InputError for other ones, and for a category without a generator.
    """
    if category.name not in GENERATORS:
        known = ", ".join(GENERATORS)
        raise InputError(f"no procedural generator for {category.name!r} (there is one for {known}); give a folder")
    for field, value in (("seed", seed), ("index", index)):
        if not 0 <= value < 2**32:  # a longer number would take two words, and could run into another stream
            raise InputError(f"{field} is {value}: give one between 0 and {2**32 - 1}")
    rng = np.random.default_rng([seed, _STREAMS[split], index])
    unusual = rng.spawn(1)[0]
    is_unusual = split == "unusual" or (split == "train" and unusual.random() < UNUSUAL)
    made: JointedParts = import_module(f".{category.name}", __name__).generate(
        rng, category, unusual if is_unusual else None
    )
    axes = np.array([joint.axis for joint in category.joints]) if made.axes is None else made.axes
    name = f"{category.name}-{split}-{seed}-{index:05d}"
    return ObjectModel.of(category, name, made.parts, axes, made.pivots, made.limits).centred()
