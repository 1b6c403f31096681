"""Object models by the name of their source, as the commands take it."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, field
from typing import Literal

from ..categories import Category
from ..errors import InputError
from ..objects import ObjectModel
from .folder import load_folder
from .procedural import generate


@dataclass(frozen=True)
class ModelSource:
    models: list[ObjectModel]
    refused: list[dict[str, str]] = field(default_factory=list)


def load_models(
    source: str, category: Category, objects: int, split: Literal["train", "test"], seed: int
) -> ModelSource:
    """Procedural objects, or those of a folder that fit; raises InputError where none does."""
    if source == "procedural":
        return ModelSource([generate(category, index, split, seed) for index in range(objects)])
    found = load_folder(source, category)
    if not found.models and len(found.refused) == 1:
        raise InputError(f"{source}: no usable model in it: {found.refused[0].reason}")
    for refusal in found.refused:
        print(f"left out {refusal.name}: {refusal.reason}", file=sys.stderr)
    if not found.models:
        raise InputError(f"{source}: none of its {len(found.refused)} models fits {category.name} (reasons above)")
    return ModelSource(found.models, [asdict(refusal) for refusal in found.refused])
