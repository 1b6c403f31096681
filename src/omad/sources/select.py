"""Object models and views by the name of their source, as the commands take it."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from typing import Literal

from ..categories import Category
from ..depth_noise import LEVELS
from ..errors import InputError
from ..objects import ObjectModel, SampledObject
from ..standard_views import View, standard_views
from ..view_folder import is_view_folder, open_views
from .artimage import Broken, is_artimage, open_artimage
from .folder import load_folder
from .procedural import generate


@dataclass(frozen=True)
class ModelSource:
    models: list[ObjectModel]
    refused: list[dict[str, str]] = field(default_factory=list)


@dataclass(frozen=True)
class ViewSource:
    views: Iterable[View]
    total: int
    noisy: bool
    """Whether a camera's noise was simulated."""
    refused: list[dict[str, str]] = field(default_factory=list)
    """Complete once all views are read."""


def load_models(
    source: str, category: Category, objects: int, split: Literal["train", "test"], seed: int
) -> ModelSource:
    """Procedural objects, or those of a folder that fit; raises InputError where none does."""
    if source == "procedural":
        return ModelSource([generate(category, index, split, seed) for index in range(objects)])
    if is_artimage(source):
        raise InputError(f"{source}: an ArtImage root holds points and images, no meshes; give a folder of models")
    found = load_folder(source, category)
    if not found.models and len(found.refused) == 1:
        raise InputError(f"{source}: no usable model in it: {found.refused[0].reason}")
    for refusal in found.refused:
        print(f"left out {refusal.name}: {refusal.reason}", file=sys.stderr)
    if not found.models:
        raise InputError(f"{source}: none of its {len(found.refused)} models fits {category.name} (reasons above)")
    return ModelSource(found.models, [asdict(refusal) for refusal in found.refused])


def load_training_objects(
    source: str, category: Category, objects: int, seed: int, broken: Broken
) -> list[SampledObject]:
    """Objects to train on: those of ``load_models``, or of the train split of an ArtImage root."""
    if source != "procedural" and is_artimage(source):
        return [thing.surface for thing in open_artimage(source, category, "train", broken).objects.values()]
    return [*load_models(source, category, objects, "train", seed).models]


def load_views(
    source: str,
    category: Category,
    objects: int,
    views: int,
    seed: int,
    noisy: bool,
    broken: Broken,
    skip: int = 0,
) -> ViewSource:
    """Views to test on: all of a rendered folder or of an ArtImage root's test split, else standard views of models;
    without the first ``skip`` of them, which ``total`` still counts.

    Raises InputError for a source of another category, and where noise is asked for that only a rendering can have.
    """
    folder = Path(source)
    if source == "procedural" or not (is_view_folder(folder) or is_artimage(folder)):
        found = load_models(source, category, objects, "test", seed)
        noise = LEVELS["on" if noisy else "off"]
        drawn = standard_views(found.models, category, views, seed, noise, skip)
        return ViewSource(drawn, views, noisy, found.refused)
    if noisy:
        raise InputError(f"{source}: is rendered already; leave out --depth-noise, or render with --noise")
    if is_artimage(folder):
        images = open_artimage(folder, category, "test", broken)
        return ViewSource(islice(images, skip, None), len(images), False, images.left_out)
    rendered = open_views(folder)
    if rendered.category != category.name:
        raise InputError(f"{source}: views of {rendered.category}, not of {category.name}")
    return ViewSource(islice(rendered, skip, None), len(rendered), rendered.noise is not None)


def shown_objects(
    source: str, category: Category, objects: int, seed: int, broken: Broken
) -> list[SampledObject] | None:
    """The complete objects that ``load_views`` shows; None of a rendered folder, which holds none."""
    if source != "procedural" and is_artimage(source):
        return [thing.surface for thing in open_artimage(source, category, "test", broken).objects.values()]
    if source != "procedural" and is_view_folder(Path(source)):
        return None
    return [*load_models(source, category, objects, "test", seed).models]
