"""Views to draw or to measure, with the object model behind each where there is one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from ..categories import Category
from ..depth_noise import LEVELS
from ..objects import ObjectModel
from ..sources.artimage import Broken, is_artimage
from ..sources.select import load_models, load_views
from ..standard_views import View, standard_view, view_seed
from ..view_folder import is_view_folder


@dataclass(frozen=True)
class Seen:
    view: View
    model: ObjectModel | None
    """None where the source holds images only."""


@dataclass(frozen=True)
class SeenViews:
    views: Iterator[Seen]
    total: int


def load_seen(
    source: str, category: Category, objects: int, views: int, seed: int, noisy: bool, broken: Broken
) -> SeenViews:
    """``views`` standard views of unseen objects, dealt out to them in turn; of a folder of images that many, spread
    evenly over it. Raises InputError as ``load_views`` does."""
    if source != "procedural" and (is_view_folder(Path(source)) or is_artimage(source)):
        found = load_views(source, category, objects, views, seed, noisy, broken)
        total = min(views, found.total)
        spread = islice(found.views, 0, None, max(1, found.total // max(1, total)))
        return SeenViews((Seen(view, None) for view in islice(spread, total)), total)
    models = load_models(source, category, objects, "test", seed).models
    noise = LEVELS["on" if noisy else "off"]

    def draw() -> Iterator[Seen]:
        for index in range(views):
            drawn = view_seed(index, len(models), seed)
            yield Seen(standard_view(models[drawn[1]], category, drawn, noise), models[drawn[1]])

    return SeenViews(draw(), views)
