"""Procedural object models: endless, seeded, at real sizes, free of other people's data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from ...categories import Category
from ...errors import InputError
from ...objects import ObjectModel
from .dishwasher import dishwasher
from .drawer import drawer
from .eyeglasses import eyeglasses
from .laptop import laptop
from .scissors import scissors

GENERATORS: dict[str, Callable[[np.random.Generator, str], ObjectModel]] = {
    "laptop": laptop,
    "eyeglasses": eyeglasses,
    "dishwasher": dishwasher,
    "scissors": scissors,
    "drawer": drawer,
}
_STREAMS = {"train": 0, "test": 1}


def generate(category: Category, index: int, split: Literal["train", "test"] = "train", seed: int = 0) -> ObjectModel:
    """Object ``index`` of a category; the same for the same arguments, and never shared between splits.

    ``seed`` and ``index`` are 32-bit. Raises InputError for other ones, and for a category without a generator.
    """
    if category.name not in GENERATORS:
        known = ", ".join(sorted(GENERATORS))
        raise InputError(f"no procedural generator for {category.name!r} (there is one for {known}); give a folder")
    for field, value in (("seed", seed), ("index", index)):
        if not 0 <= value < 2**32:  # a longer number would take two words, and could run into another stream
            raise InputError(f"{field} is {value}: give one between 0 and {2**32 - 1}")
    rng = np.random.default_rng([seed, _STREAMS[split], index])
    return GENERATORS[category.name](rng, f"{category.name}-{split}-{seed}-{index:05d}")
