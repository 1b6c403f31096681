"""Procedural object models: endless, seeded, at real sizes, free of other people's data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from ...categories import Category
from ...errors import InputError
from ...objects import ObjectModel
from .dishwasher import dishwasher
from .laptop import laptop

GENERATORS: dict[str, Callable[[np.random.Generator, str], ObjectModel]] = {
    "laptop": laptop,
    "dishwasher": dishwasher,
}
_STREAMS = {"train": 0, "test": 1}


def generate(category: Category, index: int, split: Literal["train", "test"] = "train", seed: int = 0) -> ObjectModel:
    """Object ``index`` of a category; the same for the same arguments, and never shared between splits.

    Raises InputError for a category without a generator.
    """
    if category.name not in GENERATORS:
        known = ", ".join(sorted(GENERATORS))
        raise InputError(f"no procedural generator for {category.name!r} (there is one for {known}); give a folder")
    rng = np.random.default_rng([seed, _STREAMS[split], index])
    return GENERATORS[category.name](rng, f"{category.name}-{split}-{seed}-{index:05d}")
