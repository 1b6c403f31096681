"""The commands of retrieval: build a catalogue of objects, ask it, and measure how well that goes."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from . import __version__
from .categories import Category
from .checkpoint import WEIGHTS, find_weights, load_priornet
from .errors import InputError
from .estimator import Estimator
from .experiments.predictions import data_identity, weights_identity
from .files import CLOUD_FORMATS, DEPTH_FORMATS, make_folder, write_atomic
from .inputs import InputReader, input_files
from .options import BrokenFiles, CategoryName, Device, Json, Result, Seed, Weights, check_category, check_positive
from .report import save
from .retrieval.catalogue import Catalogued, Seen, from_models, from_observations, object_of, seen_views
from .retrieval.distances import methods
from .retrieval.experiment import DrawSettings, draw_across_states, draw_galleries, evaluate_draws, openness
from .retrieval.index import Backend, ShapeIndex
from .retrieval.paper import TABLE3, USUAL_OBJECTS
from .retrieval.picture import ranking_figure
from .retrieval.pool import Pool, describe_with_omad, describe_with_siamese
from .retrieval.shards import described_in_shards
from .retrieval.siamese_encoder import SiameseEncoder
from .retrieval.signature import Metric, Space, estimate_signature, fuse, prior_fingerprint
from .runtime import pick_device
from .sources.artimage import is_artimage
from .sources.select import ViewSource, load_models, load_views
from .standard_views import View
from .view_folder import is_view_folder

UNITS = {"keypoints": "m", "beta": "", "whitened": "std"}
"""What a distance of each metric is in."""


@dataclass(frozen=True)
class IndexBuild:
    """Build a catalogue from object models, from rendered views, or from depth images and clouds of your own."""

    category: CategoryName
    output: Path
    """The index: one file, written whole or not at all."""
    source: str = "procedural"
    """procedural; a folder of URDF / PartNet-Mobility models; a folder that ``omad render`` made, or an ArtImage root;
    or a folder of depth images and clouds (a sub-folder an object, or each file an object)."""
    objects: int = 50
    """Procedural objects (those that no training has seen)."""
    metric: Metric = "keypoints"
    """How shapes are compared. keypoints: mean distance between canonical keypoints, in metres; beta: plain Euclidean
    distance of the shape parameters, as in the paper; whitened: in standard deviations of them."""
    fuse: bool = True
    """One entry an object, from all of its views together; --no-fuse: an entry a view."""
    backend: Backend = "exact"
    """exact: compares all entries, fast up to a million; faiss: nearly exact, for many millions (an extra)."""
    intrinsics: str | None = None
    """Of depth images: fx,fy,cx,cy or a file, as ``omad estimate`` takes it; so are the next three."""
    mask: Path | None = None
    """A folder with a mask for each depth image, of the same name."""
    segment: Literal["plane"] | None = None
    """plane: take away the dominant plane and keep the largest thing on it."""
    depth_scale: float | None = None
    """Metres per stored number; default 0.001 for integer images, 1 for floats and clouds."""
    broken: BrokenFiles = "refuse"
    seed: Seed = 0
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    box = None
    """A box says where the object is in one image, not in many."""

    def run(self) -> Result:
        check_positive(objects=self.objects, depth_scale=self.depth_scale)
        estimator = Estimator.from_pretrained(self.weights or self.category, self.device)
        check_category("--weights", self.weights, estimator.category, self.category)
        index = ShapeIndex(Space.of(estimator.net.prior, estimator.category, self.metric), self.backend)
        found = self._catalogued(estimator)
        if not found.entries:
            raise InputError(f"{self.source}: none of its {len(found.refused)} inputs can be used; see omad estimate")
        index.add(found.signatures, found.entries)
        index.save(self.output)
        return 0, {
            "index": str(self.output),
            "category": index.space.category,
            "metric": self.metric,
            "backend": self.backend,
            "entries": len(index),
            "objects": len({entry.name for entry in index.entries}),
            "refused": found.refused,
        }

    def _catalogued(self, estimator: Estimator) -> Catalogued:
        folder, category = Path(self.source), estimator.category
        if self.source != "procedural":
            if is_view_folder(folder) or is_artimage(folder):
                views = load_views(self.source, category, 1, 1, self.seed, False, self.broken)
                refused = list(views.refused)
                seen = seen_views(views.views, views.total, self.source, refused)
                found = from_observations(estimator, seen, self.fuse)
                return Catalogued(found.signatures, found.entries, refused)
            files = _observed(folder)
            if files:
                refused = []
                found = from_observations(estimator, self._read(folder, files, refused), self.fuse)
                return Catalogued(found.signatures, found.entries, refused)
        net = load_priornet(find_weights(self.weights or self.category) / "prior").to(pick_device(self.device))
        models = load_models(self.source, category, self.objects, "test", self.seed)
        found = from_models(net, models.models, self.source)
        return Catalogued(found.signatures, found.entries, models.refused)

    def _read(self, folder: Path, files: list[Path], refused: list[dict[str, str]]) -> Iterator[Seen]:
        reader = InputReader.of(self, files)
        for file in files:
            try:
                yield Seen(object_of(file, folder), str(file), reader(file))
            except InputError as error:
                refused.append({"name": str(file), "reason": str(error)})


@dataclass(frozen=True)
class IndexQuery:
    """Ask a catalogue which object this is: one depth image or cloud, or several of the same object."""

    inputs: tyro.conf.Positional[tuple[Path, ...]]
    """Depth images or clouds; several are taken for views of one object, and count together."""
    index: Path
    """What ``omad index build`` wrote."""
    count: int = 5
    """Objects to name."""
    by_information: bool = False
    """Weigh every direction of shape by how surely these views show it."""
    intrinsics: str | None = None
    """Of the depth camera: fx,fy,cx,cy or a file, as ``omad estimate`` takes it; so are the next four."""
    mask: Path | None = None
    """Image, non-zero where the object is; or a folder with a mask for each input, of the same name."""
    box: str | None = None
    """x1,y1,x2,y2 in pixels around the object, half-open."""
    segment: Literal["plane"] | None = None
    """plane: take away the dominant plane and keep the largest thing on it."""
    depth_scale: float | None = None
    """Metres per stored number; default 0.001 for integer images, 1 for floats and clouds."""
    output: Path = Path("omad-query")
    """Folder for the ranking as a picture, and the thumbnails."""
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(count=self.count, depth_scale=self.depth_scale)
        index = ShapeIndex.load(self.index)
        files = input_files(self.inputs)
        reader = InputReader.of(self, files)
        estimator = Estimator.from_pretrained(self.weights or index.space.category, self.device)
        prior = prior_fingerprint(estimator.net.prior, estimator.category)
        if prior != index.space.prior:
            raise InputError(
                f"{self.index}: made with prior {index.space.prior}, these weights have prior {prior}; give --weights"
                " the folder that made it, or build the index anew"
            )
        observations = [reader(file) for file in files]
        estimates = estimator(observations)
        signature = fuse([estimate_signature(estimate, prior) for estimate in estimates])
        hits = index.search_objects(signature, self.count, self.by_information)
        unit = "std" if self.by_information else UNITS[index.space.metric]
        save(ranking_figure(observations, hits, unit), self.output / "ranking.png")
        ranking = []
        for number, hit in enumerate(hits, 1):
            path = self.output / f"{number:02d}.png"
            if hit.entry.thumbnail:
                write_atomic(path, lambda temporary, png=hit.entry.thumbnail: temporary.write_bytes(png))
            ranking.append(
                {
                    "object": hit.entry.name,
                    "distance": hit.distance,
                    "source": hit.entry.source,
                    "thumbnail": str(path) if hit.entry.thumbnail else None,
                }
            )
        return 0, {
            "inputs": [str(file) for file in files],
            "index": str(self.index),
            "category": index.space.category,
            "unit": unit,
            "ranking": ranking,
            "picture": str(self.output / "ranking.png"),
            "warnings": sorted({warning for estimate in estimates for warning in estimate.warnings}),
        }


@dataclass(frozen=True)
class EvalRetrieval:
    """The paper's Table 3: how well views of the same unseen object find each other, whatever pose and joint states.

    OMAD (refined and initial) against the Siamese network, beside the chance level; on galleries of as many objects as
    the paper's, on one of all objects ("large"), and with queries opened and galleries closed ("across_states")."""

    category: str | None = None
    """Only this one; default: every category with weights."""
    source: str = "procedural"
    """procedural, or a folder as ``omad eval pose`` takes it (an ArtImage root, say)."""
    objects: int = 50
    """Procedural objects in all, from which galleries are drawn."""
    views: int = 100
    """Of each of them; of a rendered folder or an ArtImage root always all."""
    gallery: int | None = None
    """Objects in a gallery; default: the paper's number for the category."""
    draws: int = 20
    """Galleries that the scores are averaged over."""
    queries: int = 100
    """Of each gallery."""
    seed: Seed = 0
    depth_noise: bool = False
    """Simulate the depth camera's noise."""
    broken: BrokenFiles = "refuse"
    cache: Path = Path("omad-retrieval")
    """Folder of signatures. Those of other weights, settings or data are refused."""
    weights: Path | None = None
    """Folder with a sub-folder a category in place of the shipped weights: <category>/ of OMADNet, and in it siamese/
    of the Siamese network. Without the latter that is left out."""
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Result:
        check_positive(objects=self.objects, views=self.views, gallery=self.gallery)
        check_positive(draws=self.draws, queries=self.queries)
        folder = self.weights or WEIGHTS
        names = sorted(path.parent.name for path in folder.glob("*/config.json"))
        if self.category is not None:
            names = [self.category]
        if not names:
            raise InputError(f"{folder}: no <category>/config.json in it; give a folder with one checkpoint a category")
        return 0, {name: self._category(folder / name) for name in names}

    def _category(self, folder: Path) -> dict[str, Any]:
        estimator = Estimator.from_pretrained(folder, self.device)
        category = estimator.category
        pool, embeddings = self._pool(estimator, folder)
        paper = TABLE3.get(category.name)
        count = self.gallery or (paper.objects if paper else USUAL_OBJECTS)
        settings = DrawSettings(self.draws, self.queries, self.seed)
        total = len(np.unique(pool.objects))
        usual = draw_galleries(pool.objects, count, settings)
        large = draw_galleries(pool.objects, total, settings)
        across = draw_across_states(pool.objects, openness(pool.states, category), count, settings)
        answer = {}
        for name, method in methods(pool, embeddings, estimator.net.prior, category).items():
            answer[name] = evaluate_draws(usual, pool.objects, method) | {
                "large": evaluate_draws(large, pool.objects, method),
                "across_states": evaluate_draws(across, pool.objects, method),
                "paper": getattr(paper, name, None),
            }
        return answer

    def _pool(self, estimator: Estimator, folder: Path) -> tuple[Pool, np.ndarray | None]:
        """From the cache as far as they are there; the rest is made, and put there."""
        category, siamese = estimator.category, folder / "siamese"
        cache = self.cache / category.name
        make_folder(cache)
        total, data = self._load(category).total, {"data": self._data(category), "version": __version__}

        def views(skip: int) -> Iterable[View]:
            return self._load(category, skip).views

        made_of = data | {"weights": weights_identity(folder), "settings": repr(estimator.config)}
        found = described_in_shards(cache / "omad", made_of, total, views, partial(describe_with_omad, estimator))
        pool = Pool(**found)
        if not (siamese / "config.json").is_file():
            print(f"{category.name}: no weights in {siamese}; omad train siamese makes them", file=sys.stderr)
            return pool, None
        encoder = SiameseEncoder.from_folder(siamese, self.device)
        made_of = data | {"weights": weights_identity(siamese)}
        found = described_in_shards(cache / "siamese", made_of, total, views, partial(describe_with_siamese, encoder))
        return pool, found["embeddings"]

    def _load(self, category: Category, skip: int = 0) -> ViewSource:
        views = self.objects * self.views
        return load_views(self.source, category, self.objects, views, self.seed, self.depth_noise, self.broken, skip)

    def _data(self, category: Category) -> str:
        settings = {"objects": self.objects, "views": self.views, "seed": self.seed, "noise": self.depth_noise}
        return data_identity(list(islice(self._load(category).views, 3)), self.source, settings)


def _observed(folder: Path) -> list[Path]:
    """Depth images and clouds in a folder and its sub-folders; none where it holds URDFs, whose meshes look alike."""
    if not folder.is_dir() or next(folder.rglob("*.urdf"), None):
        return []
    known = {*DEPTH_FORMATS, *CLOUD_FORMATS} - {".txt"}
    return sorted(p for p in folder.glob("**/[!.]*") if p.suffix.lower() in known and p.is_file())
