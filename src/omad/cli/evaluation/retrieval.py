"""``omad eval retrieval``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from math import isnan
from pathlib import Path
from typing import Any

from tyro.conf import OmitArgPrefixes

import omad
from omad.common.errors import InputError
from omad.common.files import make_folder
from omad.common.lazy import lazy_imports
from omad.common.user_cache import kept_at

from ..answer import Answer, table
from ..options import Device, Json, Views, check_positive, checkpoints

with lazy_imports():
    from numpy import ndarray

    from omad.evaluation.baselines.siamese import SiameseEncoder
    from omad.evaluation.paper import published
    from omad.evaluation.paper.predictions import weights_identity
    from omad.evaluation.retrieval import experiment
    from omad.evaluation.retrieval.distances import methods
    from omad.evaluation.retrieval.pool import Pool, describe_with_omad, describe_with_siamese
    from omad.evaluation.retrieval.shards import described_in_shards
    from omad.model.checkpoint import is_checkpoint


@dataclass(frozen=True)
class ViewsOfEach(Views):
    """Views by the object, as retrieval counts them."""

    objects: int = 50
    """Procedural objects in all, from which galleries are drawn."""
    views: int = 100
    """Of each object; of a rendered folder or an ArtImage root always all."""

    @property
    def total(self) -> int:
        return self.objects * self.views


@dataclass(frozen=True, kw_only=True)
class EvalRetrieval:
    """The paper's Table 3: how well views of the same unseen object find each other, whatever pose and joint states.

    OMAD (refined and initial) against the Siamese network, beside the chance level; on galleries of as many objects as
    the paper's, on one of all objects ("large"), and with queries opened and galleries closed ("across_states")."""

    category: str | None = None
    """Only this one; default: every category with weights."""
    data: OmitArgPrefixes[ViewsOfEach] = ViewsOfEach()
    gallery: int | None = None
    """Objects in a gallery; default: the paper's number for the category."""
    draws: int = 20
    """Galleries that the scores are averaged over."""
    queries: int = 100
    """Of each gallery."""
    cache: Path | None = None
    """Folder of signatures; those of other weights, settings or data are refused. Default: in the user's cache."""
    weights: Path | None = None
    """Folder with a sub-folder a category in place of the shipped weights: <category>/ of OMADNet, and in it siamese/
    of the Siamese network. Without the latter that is left out."""
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Answer:
        self.data.check()
        check_positive(gallery=self.gallery, draws=self.draws, queries=self.queries)
        names = () if self.category is None else (self.category,)
        return Answer(dict(self._category(folder) for folder in checkpoints(self.weights, names)), retrieval_text)

    def _category(self, folder: Path) -> tuple[str, dict[str, Any]]:
        """Its name, and the scores of every method."""
        estimator = omad.Estimator.from_pretrained(folder, self.device)
        category = estimator.category
        pool, embeddings = self._pool(estimator, folder)
        printed = published.TABLE3.get(category.name)
        count = self.gallery or (printed.objects if printed else published.USUAL_OBJECTS)
        settings = experiment.DrawSettings(self.draws, self.queries, self.data.seed)
        openness, everything = experiment.openness(pool.states, category), len(set(pool.objects.tolist()))
        if self.gallery and self.gallery > everything:
            raise InputError(f"{self.data.source}: has {everything} objects of {category.name}; give --gallery no more")
        galleries = [experiment.draw_galleries(pool.objects, size, settings) for size in (count, everything)]
        galleries.append(experiment.draw_across_states(pool.objects, openness, count, settings))
        answer = {}
        for name, method in methods(pool, embeddings, estimator.net.prior, category).items():
            usual, large, across = (experiment.evaluate_draws(draws, pool.objects, method) for draws in galleries)
            answer[name] = usual | {"large": large, "across_states": across, "paper": getattr(printed, name, None)}
        return category.name, answer

    def _pool(self, estimator: omad.Estimator, folder: Path) -> tuple[Pool, ndarray | None]:
        """From the cache as far as they are there; the rest is made, and put there."""
        data, category, siamese = self.data, estimator.category, folder / "siamese"
        cache = None if self.cache is None else self.cache / category.name
        source = data.load(category)
        total, identity = source.total, data.identity(source)
        made_of = identity | {"weights": weights_identity(folder), "settings": repr(estimator.config)}

        def described(name: str, made_of: dict[str, str], make: Any) -> dict[str, ndarray]:
            folder = kept_at(cache, "retrieval", name if cache else f"{category.name}-{name}", made_of)
            make_folder(folder)
            return described_in_shards(folder, made_of, total, lambda skip: data.load(category, skip).views, make)

        pool = Pool(**described("omad", made_of, partial(describe_with_omad, estimator)))
        if not is_checkpoint(siamese):
            print(
                f"{category.name}: no weights in {siamese}; pip install 'omad[baselines]', or omad train siamese",
                file=sys.stderr,
            )
            return pool, None
        encoder = SiameseEncoder.from_folder(siamese, self.device)
        made_of = identity | {"weights": weights_identity(siamese)}
        return pool, described("siamese", made_of, partial(describe_with_siamese, encoder))["embeddings"]


def retrieval_text(answer: dict[str, Any]) -> str:
    """The paper's Table 3, per cent; the chance level beside it."""
    rows = [["category", "method", "mAP@10", "NN", "1st tier", "2nd tier", "all objects", "across states", "paper"]]
    for category, methods in answer.items():
        first = methods["omad"]
        chance = first["chance"] | {key: first[key]["chance"] for key in ("large", "across_states")}
        for name, found in {**methods, "chance": chance}.items():
            shares = [found[key] for key in ("map_at_10", "nearest_neighbour", "first_tier", "second_tier")]
            shares += [found["large"]["map_at_10"], found["across_states"]["map_at_10"], found.get("paper")]
            rows.append(
                [category, name, *("-" if share is None or isnan(share) else f"{100 * share:.1f}" for share in shares)]
            )
    return table(rows)
