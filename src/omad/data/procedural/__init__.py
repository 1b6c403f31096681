"""Procedural object models: endless, seeded, at real sizes, free of other people's data.

A module in one of the groups, ``appliances``, ``handheld`` and ``storage``, that is called like a shipped category is
its generator, and of those whose names go on after an underscore: ``drawer`` makes chests of one drawer, ``drawer_1``.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from omad.common.errors import InputError
from omad.objects.builtin import builtin_names
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .shapes import JointedParts


def _modules() -> dict[str, str]:
    """By the names of shipped categories, the modules that generate them."""
    known = {file.stem: f".{file.parent.name}.{file.stem}" for file in Path(__file__).parent.glob("*/*.py")}
    found = {name: [known[part] for part in (name, *_shorter(name)) if part in known] for name in builtin_names()}
    return {name: modules[0] for name, modules in found.items() if modules}


def _shorter(name: str) -> list[str]:
    """The name without its last word, its last two words, and so on."""
    words = name.split("_")
    return ["_".join(words[:count]) for count in range(len(words) - 1, 0, -1)]


_MODULES = _modules()
GENERATORS = tuple(_MODULES)
"""Categories that have one: ``<module>.generate(rng, category, unusual) -> JointedParts``. For an unusual member of the
category, where there are such, ``unusual`` has random numbers, else it is None."""
Generator: TypeAlias = Callable[[np.random.Generator, Category, np.random.Generator | None], JointedParts]
_STREAMS = {"train": 0, "test": 1, "unusual": 2}
UNUSUAL = 0.15
"""Share of the objects to train on that are unusual, where a category has such members."""


def generate(
    category: Category,
    index: int,
    split: Literal["train", "test", "unusual"] = "train",
    seed: int = 0,
    make: Generator | None = None,
) -> ObjectModel:
    """Object ``index`` of a category; the same for the same arguments, and never shared between splits. ``"unusual"``
    are unusual members alone, as a share of those to train on is and none of ``"test"``: results on that one stay
    comparable while families grow.

    ``seed`` and ``index`` are 32-bit; ``make`` is a generator of one's own. Raises InputError for other numbers, and
    for a category without a generator.
    """
    if make is None and category.name not in GENERATORS:
        known = ", ".join(GENERATORS)
        cure = "give a folder, or a generator of your own"
        raise InputError(f"no procedural generator for {category.name!r} (there is one for {known}); {cure}")
    for field, value in (("seed", seed), ("index", index)):
        if not 0 <= value < 2**32:  # a longer number would take two words, and could run into another stream
            raise InputError(f"{field} is {value}: give one between 0 and {2**32 - 1}")
    rng = np.random.default_rng([seed, _STREAMS[split], index])
    unusual = rng.spawn(1)[0]
    is_unusual = split == "unusual" or (split == "train" and unusual.random() < UNUSUAL)
    make_one: Generator = make or import_module(_MODULES[category.name], __name__).generate
    made = make_one(rng, category, unusual if is_unusual else None)
    axes = np.array([joint.axis for joint in category.joints]) if made.axes is None else made.axes
    name = f"{category.name}-{split}-{seed}-{index:05d}"
    return ObjectModel.of(category, name, made.parts, axes, made.pivots, made.limits).centred()
