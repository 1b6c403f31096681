"""Object models and views by the name of their source, as the commands take it.

A new kind of source is a file that reads it and an entry in ``KINDS``.
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Literal, Self, TypeAlias

from omad.common.errors import InputError
from omad.common.files import stamp
from omad.objects.category import Category
from omad.objects.model import ObjectModel, SampledObject

from .artimage import is_artimage, open_artimage
from .broken import Broken
from .procedural import generate
from .procedural.own import SUFFIX, check_family, own_generator
from .rendering.depth_noise import LEVELS
from .rendering.standard_views import View, standard_views
from .rendering.view_folder import is_view_folder, open_views
from .shards.views import is_view_shards, open_view_shards
from .urdf_import.folder import load_folder
from .variation import with_variants

Split: TypeAlias = Literal["train", "test"]


@dataclass(frozen=True)
class ModelSource:
    """Object models, in their category's canonical space, metres."""

    models: list[ObjectModel]
    refused: list[dict[str, str]] = field(default_factory=list)
    """Name and reason: those that cannot be used."""
    notes: list[dict[str, str]] = field(default_factory=list)
    """Name and reason: what had to be put right about models, as that they are mirror images."""


@dataclass(frozen=True)
class ViewSource:
    """Views with their truth, drawn or read one by one as they are taken."""

    views: Iterable[View]
    total: int
    noisy: bool
    """Whether a camera's noise was simulated."""
    refused: list[dict[str, str]] = field(default_factory=list)
    """Name and reason of what cannot be used. Complete once all views are read."""
    models: Sequence[ObjectModel] = ()
    """What the views were rendered of; none where the source holds images only."""
    made_of: str = ""
    """Of images: what tells them from others of that name, as far as it is known before any is read."""

    def spread(self, count: int) -> Self:
        """So many of the views, evenly over all of them."""
        total = min(count, self.total)
        chosen = {index * self.total // total for index in range(total)}
        taken = zip(range(max(chosen, default=-1) + 1), self.views, strict=False)
        return replace(self, views=(view for index, view in taken if index in chosen), total=total)

    def model_of(self, view: View) -> ObjectModel | None:
        """The object behind one of the views, where there is one."""
        return self.models[view.seed[1]] if self.models else None


@dataclass(frozen=True)
class SourceKind:
    """How a kind of source is known and read. All but the first is left out where the kind does not hold it; errors
    are InputErrors that name the source."""

    is_one: Callable[[str], bool]
    makes: bool = False
    """As many objects as one likes."""
    models: Callable[[str, Category, int, Split, int], ModelSource] | None = None
    """Objects with meshes, of which views can be rendered, by source, category, their number, split and seed."""
    surfaces: Callable[[str, Category, Split, Broken], list[SampledObject]] | None = None
    """Complete objects without meshes."""
    images: Callable[[str, Category, Broken, int, bool], ViewSource] | None = None
    """Views to test on, without the first so many of them, which the total counts; those of one object together, if so
    asked and they can be read so."""

    @property
    def has_objects(self) -> bool:
        """Whether complete objects can be had."""
        return self.models is not None or self.surfaces is not None


def _generated(source: str, category: Category, objects: int, split: Split, seed: int) -> ModelSource:
    return ModelSource([generate(category, index, split, seed) for index in range(objects)])


def _urdfs(source: str, category: Category, objects: int, split: Split, seed: int) -> ModelSource:
    found = load_folder(source, category)
    if not found.models and len(found.refused) == 1:
        raise InputError(f"{source}: no usable model in it: {found.refused[0].reason}")
    for refusal in found.refused:
        print(f"left out {refusal.name}: {refusal.reason}", file=sys.stderr)
    if not found.models:
        raise InputError(f"{source}: none of its {len(found.refused)} models fits {category.name} (reasons above)")
    for note in found.notes:
        _say_once(str(Path(source).absolute()), f"note on {note.name}: {note.reason}")
    refused, notes = ([asdict(each) for each in listed] for listed in (found.refused, found.notes))
    return ModelSource(found.models, refused, notes)


@cache
def _say_once(source: str, text: str) -> None:
    """On stderr, however often a command reads the ``source``."""
    print(text, file=sys.stderr)


def _artimage_surfaces(source: str, category: Category, split: Split, broken: Broken) -> list[SampledObject]:
    return [thing.surface for thing in open_artimage(source, category, split, broken).objects.values()]


def _artimage_images(source: str, category: Category, broken: Broken, skip: int, by_object: bool) -> ViewSource:
    images = open_artimage(source, category, "test", broken)
    made_of = repr([(annotation.path.name, stamp(annotation.path)) for annotation in images.annotations])
    return ViewSource(islice(images, skip, None), len(images), False, images.left_out, made_of=made_of)


def _rendered_images(source: str, category: Category, broken: Broken, skip: int, by_object: bool) -> ViewSource:
    rendered = replace(open_views(source, broken, category), by_object=by_object)
    noisy = rendered.noise is not None or rendered.clutter
    made_of = repr([rendered.objects, rendered.views, rendered.seed, rendered.noise, rendered.clutter, rendered.stamp])
    return ViewSource(rendered.after(skip), len(rendered), noisy, rendered.left_out, made_of=made_of)


def _images_in_shards(source: str, category: Category, broken: Broken, skip: int, by_object: bool) -> ViewSource:
    if broken == "skip":
        raise InputError(
            f"{source}: views in shards are all counted; leave out --broken skip, render broken ones again"
        )
    shards = open_view_shards(source, category)
    return ViewSource(shards.after(skip), len(shards), shards.noisy, made_of=shards.run)


def _unusual(source: str, category: Category, objects: int, split: Split, seed: int) -> ModelSource:
    if split == "train":
        raise InputError(f"{source}: its objects are the same in each split, to test on; give another source")
    return ModelSource([generate(category, index, "unusual", seed) for index in range(objects)])


def _mirrored(source: str, category: Category, objects: int, split: Split, seed: int) -> ModelSource:
    if not category.either_hand:
        raise InputError(f"{source}: a {category.name} has one hand (either_hand in its spec); use procedural")
    return ModelSource([generate(category, index, split, seed).mirrored() for index in range(objects)])


def _of_own(source: str, category: Category, objects: int, split: Split, seed: int) -> ModelSource:
    make = own_generator(source)
    models = [generate(category, index, split, seed, make) for index in range(objects)]
    check_family(source, models, category)
    return ModelSource(models)


KINDS: dict[str, SourceKind] = {
    "procedural": SourceKind(lambda source: source == "procedural", True, _generated),
    "unusual": SourceKind(lambda source: source == "unusual", True, _unusual),
    "mirrored": SourceKind(lambda source: source == "mirrored", True, _mirrored),
    "generator": SourceKind(lambda source: source.endswith(SUFFIX), True, _of_own),
    "artimage": SourceKind(is_artimage, surfaces=_artimage_surfaces, images=_artimage_images),
    "rendered": SourceKind(is_view_folder, images=_rendered_images),
    "shards": SourceKind(is_view_shards, images=_images_in_shards),
    "urdf": SourceKind(lambda source: True, models=_urdfs),
}
"""The first that knows a source as its own reads it."""


def kind_of(source: str) -> SourceKind:
    """What a source is."""
    return next(kind for kind in KINDS.values() if kind.is_one(source))


def is_generated(source: str) -> bool:
    """Whether it makes as many objects as one likes."""
    return kind_of(source).makes


def load_models(source: str, category: Category, objects: int, split: Split, seed: int) -> ModelSource:
    """Procedural objects, or those of a folder that fit; raises InputError where none does."""
    kind = kind_of(source)
    if kind.models is None:
        raise InputError(f"{source}: holds images, no meshes; give a folder of models")
    return kind.models(source, category, objects, split, seed)


def load_objects(
    source: str, category: Category, objects: int, split: Split, seed: int, broken: Broken, variants: int = 0
) -> list[SampledObject]:
    """Complete objects, with or without meshes; those of the test split are what ``load_views`` shows. Models of one's
    own, where they are fewer than ``variants``, are varied until there are so many. Raises InputError where there are
    none."""
    surfaces = kind_of(source).surfaces
    if surfaces is not None:
        return surfaces(source, category, split, broken)
    models = load_models(source, category, objects, split, seed).models
    return with_variants(models, category, variants if kind_of(source) is KINDS["urdf"] else 0)


def load_views(
    source: str, category: Category, objects: int, views: int, seed: int, noise: str, broken: Broken, skip: int = 0,
    by_object: bool = False,
) -> ViewSource:  # fmt: skip
    """Views to test on: all images that a source holds, else standard views of its models, of which no more are
    generated than there are views; without the first ``skip`` of them, which ``total`` still counts. ``noise``: one of
    ``depth_noise.LEVELS``; ``by_object``: images of one object come together, but those in shards. Raises InputError
    for a source of another category, and where noise is asked for that only a rendering can have."""
    images = kind_of(source).images
    if images is None:
        found = load_models(source, category, min(objects, views), "test", seed)
        drawn = standard_views(found.models, category, views, seed, LEVELS[noise], skip)
        return ViewSource(drawn, views, noise != "off", found.refused, found.models)
    if noise != "off":
        raise InputError(f"{source}: is rendered already; leave out --depth-noise, or render it with that")
    return images(source, category, broken, skip, by_object)
