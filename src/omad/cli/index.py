"""``omad index build | query``: a catalogue of objects, which is asked what an object is by its shape."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from tyro.conf import OmitArgPrefixes, Positional

import omad
from omad.common.errors import InputError, as_line
from omad.common.files import check_folder, replacing, stamp, write_atomic
from omad.common.lazy import lazy_imports
from omad.sensing.input_options import InputOptions

from .answer import Answer, table
from .options import (
    MADE,
    BrokenFiles,
    CategoryCommand,
    Device,
    Json,
    Seed,
    Weights,
    check_positive,
    check_unused,
    prior_of,
)

with lazy_imports():
    from omad.applications.retrieval import catalogue
    from omad.applications.retrieval.index import Hit, check_place
    from omad.applications.retrieval.large.large_index import LargeIndex, open_index
    from omad.applications.retrieval.large.parts import Portion
    from omad.applications.retrieval.large.stream import portions_of_inputs, portions_of_models
    from omad.applications.retrieval.picture import ranking_figure
    from omad.applications.retrieval.signature import (
        Space,
        check_one_hand,
        estimate_signature,
        fuse,
        prior_fingerprint,
    )
    from omad.common.batches import progress
    from omad.common.incoming import address_of, is_path
    from omad.data.source import ModelSource, ViewSource, is_generated, kind_of, load_models, load_views
    from omad.data.urdf_import.folder import is_urdf
    from omad.model.checkpoint import find_weights
    from omad.objects.category import Category
    from omad.objects.model import ObjectModel
    from omad.output.picture import how_sure, save
    from omad.sensing.reader import InputReader, files_in, input_files

UNITS = {"keypoints": "m", "beta": "", "whitened": "std"}
"""What a distance of each metric is in."""
READING = "goes with a folder of depth images or clouds"
MIRRORED = " in the mirror"
"""Behind the distance of an object of the other hand."""


@dataclass(frozen=True, kw_only=True)
class IndexBuild(CategoryCommand):
    """Build a catalogue from object models, from rendered views, or from depth images and clouds of your own."""

    output: Path
    """The index: one file, written whole or not at all; with --backend disk a folder, which is added to if it is there
    already, and goes on when the same command is given again after one that was interrupted."""
    source: str = "procedural"
    """procedural; a generator of your own (.py); a folder of URDF / PartNet-Mobility models; what ``omad render`` made,
    or an ArtImage root; or a folder of depth images and clouds (a sub-folder an object, or each file an object). One
    that cannot be read is named on stderr and under "refused", the others go in, and the exit code is 2."""
    objects: int = 50
    """Procedural objects (those that no training has seen)."""
    metric: Literal["keypoints", "beta", "whitened"] = "keypoints"
    """How shapes are compared. keypoints: root of the mean squared distance between canonical keypoints, in metres;
    beta: plain Euclidean distance of the shape parameters, as in the paper; whitened: in standard deviations of
    them."""
    fuse: bool = True
    """One entry an object, from all of its views together (on disk, of views in shards, from some hundred of all
    objects at a time); --no-fuse: an entry a view."""
    backend: Literal["exact", "faiss", "disk"] = "exact"
    """exact: compares all entries, fast up to a million; faiss: nearly exact, for many millions; disk: nearly exact, of
    a stream, for more than memory holds. The last two are an extra."""
    reading: OmitArgPrefixes[InputOptions] = InputOptions()
    broken: BrokenFiles = "refuse"
    seed: Seed = 0

    def run(self) -> Answer:
        check_positive(objects=self.objects, depth_scale=self.reading.depth_scale)
        estimator = self.estimator()
        space = Space.of(estimator.net.prior, estimator.category, self.metric)
        if self.backend == "disk":
            return self._on_disk(estimator, space)
        check_place(self.output)  # rather now than after the work
        index = omad.ShapeIndex(space, self.backend)
        found = self._catalogued(estimator)
        if not found.entries:
            raise self._nothing_usable(found.refused)
        index.add(found.signatures, found.entries)
        index.save(self.output)
        names = {entry.name for entry in index.entries}
        record = {"index": str(self.output), "category": index.space.category, "metric": self.metric}
        record |= {"backend": self.backend, "entries": len(index), "objects": len(names), "refused": found.refused}
        return self._answer(record | {"doubtful": found.doubtful})

    def _on_disk(self, estimator: omad.Estimator, space: Space) -> Answer:
        index, refused, doubtful = LargeIndex.create(self.output, space), list[dict[str, str]](), list[dict[str, Any]]()
        there = self.source if self.source in MADE else address_of(self.source) or os.path.realpath(self.source)
        source = f"{there} {self.seed}" if is_generated(self.source) else there  # however it is spelled
        files, models, names, read = self._files, list[ObjectModel](), list[str](), ""
        views = self._views(estimator.category)
        if views is not None:
            read = repr((views.made_of, self.fuse))
        elif files:
            names, read = [_stamped(file, Path(self.source)) for file in files], repr((self.reading, self.fuse))
        else:
            found = self._models(estimator.category)
            models = list(found.models)
            names = [model.name if self.source in MADE else _measured(model) for model in models]
            refused += found.refused

        def portions() -> Iterator[Portion]:
            taken = index.taken(source)  # asked for when nobody else adds any more
            yield from self._portions(estimator, taken, files, models, refused, doubtful)

        index.add(portions(), source, names, read)
        if not len(index):
            raise self._nothing_usable(refused)
        record = {"index": str(self.output), "category": space.category, "metric": self.metric}
        record |= {"backend": self.backend, "entries": len(index), "refused": refused, "doubtful": doubtful}
        return self._answer(record)

    def _answer(self, record: dict[str, Any]) -> Answer:
        """With a line on stderr for each file of one's own that cannot be read, and then exit code 2; models that do
        not fit are nothing unusual."""
        bad = record["refused"] if self._files else []
        for one in bad:
            print(as_line(f"omad: {one['reason']}"), file=sys.stderr)
        return Answer(record, code=2 if bad else 0)

    def _nothing_usable(self, refused: list[dict[str, str]]) -> InputError:
        first = f": {refused[0]['reason']}" if refused else ""
        return InputError(f"{self.source}: none of its {len(refused)} inputs can be used{first}")

    def _portions(
        self,
        estimator: omad.Estimator,
        taken: int,
        files: list[Path],
        models: list[ObjectModel],
        refused: list[dict[str, str]],
        doubtful: list[dict[str, Any]],
    ) -> Iterator[Portion]:
        """All that the source holds, views, depth ``files`` or ``models``, without its first ``taken`` inputs; what is
        ``refused`` or ``doubtful`` of it is added to these."""
        folder = Path(self.source)
        if (views := self._views(estimator.category, taken)) is not None:
            rest = enumerate(progress(views.views, views.total, done=taken), taken)
            yield from portions_of_inputs(
                estimator,
                rest,
                lambda view: view[1].object,
                lambda some: catalogue.seen_views(some, self.source, refused),
                self.fuse,
                doubtful,
            )
            refused += views.refused
            return
        if files:
            rest = progress(files[taken:], len(files), unit="file", done=taken)
            yield from portions_of_inputs(
                estimator,
                rest,
                lambda file: catalogue.object_of(file, folder),
                lambda some: self._read(folder, some, refused),
                self.fuse,
                doubtful,
            )
            return
        net = prior_of(find_weights(self.weights or self.category), self.device)
        yield from portions_of_models(net, models[taken:], self.source)

    def _views(self, category: Category, taken: int = 0) -> ViewSource | None:
        """Those that the source holds, without the first ``taken``; None where it holds none."""
        if kind_of(self.source).images is None:
            return None
        check_unused(self.reading, READING)
        return load_views(self.source, category, 1, 1, self.seed, "off", self.broken, taken, self.fuse)

    def _models(self, category: Category) -> ModelSource:
        found = load_models(self.source, category, self.objects, "test", self.seed)
        check_unused(self.reading, READING)
        return found

    @cached_property
    def _files(self) -> list[Path]:
        """Depth images and clouds, where the source is a folder of such."""
        folder = Path(self.source)
        if self.source == "procedural" or not is_path(folder) or kind_of(self.source).images is not None:
            return []
        if any(map(is_urdf, folder.rglob("*"))):
            return []
        files = files_in(folder, "**/[!.]*")
        catalogue.check_objects_apart(files, folder)
        return files

    def _catalogued(self, estimator: omad.Estimator) -> catalogue.Catalogued:
        category = estimator.category
        refused: list[dict[str, str]] = []
        if (views := self._views(category)) is not None:
            every, refused = enumerate(progress(views.views, views.total)), views.refused
            seen = catalogue.seen_views(every, self.source, refused)
        elif files := self._files:
            seen = self._read(Path(self.source), files, refused)
        else:  # models, whose meshes look like clouds
            net = prior_of(find_weights(self.weights or self.category), self.device)
            models = self._models(category)
            return replace(catalogue.from_models(net, models.models, self.source), refused=models.refused)
        return replace(catalogue.from_observations(estimator, seen, self.fuse), refused=refused)

    def _read(self, folder: Path, files: list[Path], refused: list[dict[str, str]]) -> Iterator[catalogue.Seen]:
        reader = InputReader.of(self.reading, files)
        for file in files:
            try:
                yield catalogue.Seen(catalogue.object_of(file, folder), str(file), reader(file))
            except InputError as error:
                refused.append({"name": str(file), "reason": str(error)})


def _stamped(file: Path, folder: Path) -> str:
    """A file's name in the ``folder``, its size and when it was written: another file of that name is another input."""
    return f"{file.relative_to(folder).as_posix()}\0{stamp(file)}"


DIGITS = 4
"""Behind the point, of metres that tell one model from another: processors round further ones otherwise."""


def _measured(model: ObjectModel) -> str:
    """A model's name and its parts' boxes: another model of that name is another input."""
    return f"{model.name}\0{model.part_boxes().round(DIGITS).tolist()}"


@dataclass(frozen=True, kw_only=True)
class IndexMerge:
    """Put catalogues that were built apart, by several machines say, into one on disk; what is in already stays out."""

    indices: Positional[tuple[Path, ...]]
    """Catalogues of the same weights and metric, of any backend."""
    output: Path
    """Folder of a catalogue, new or to be added to."""
    json: Json = False

    def run(self) -> Answer:
        if not self.indices:
            raise InputError("no catalogue to merge; give at least one")
        if itself := [path for path in self.indices if path.resolve() == self.output.resolve()]:
            raise InputError(f"{itself[0]}: is the catalogue to merge into; leave it out, what is in it stays")
        space = open_index(self.indices[0]).space
        for path in self.indices:  # rather now than with some of them merged
            space.check_same(open_index(path).space, path, self.indices[0])
        into = LargeIndex.create(self.output, space)
        for path in self.indices:
            into.merge(open_index(path), str(path.resolve()))  # however it is spelled
        return Answer({"index": str(self.output), "merged": [*map(str, self.indices)], "entries": len(into)})


@dataclass(frozen=True, kw_only=True)
class IndexQuery:
    """Ask a catalogue which object this is: one depth image or cloud, or several of the same object."""

    inputs: Positional[tuple[Path, ...]]
    """Depth images or clouds; several are taken for views of one object, and count together. Those that surely show
    objects of different hands (doors hinged on different sides) are refused."""
    index: Path
    """What ``omad index build`` or ``merge`` wrote."""
    count: int = 5
    """Objects to name."""
    by_information: bool = False
    """Weigh every direction of shape by how surely these views show it."""
    reading: OmitArgPrefixes[InputOptions] = InputOptions()
    output: Path = Path("omad-query")
    """Folder for the ranking as a picture, and the thumbnails."""
    weights: Weights = None
    device: Device = "cpu"
    json: Json = False

    def run(self) -> Answer:
        check_positive(count=self.count, depth_scale=self.reading.depth_scale)
        check_folder(self.output)
        index, files = open_index(self.index), input_files(self.inputs)
        reader = InputReader.of(self.reading, files)
        estimator = omad.Estimator.from_pretrained(self.weights or index.space.category, self.device)
        prior = prior_fingerprint(estimator.net.prior, estimator.category)
        if prior != index.space.prior:
            cure = "give --weights the folder that made it, or build the index anew"
            said = f"made with prior {index.space.prior}, these weights have prior {prior}"
            raise InputError(f"{self.index}: {said}; {cure}")
        observations = [*map(reader, files)]
        estimates = estimator(observations)
        signatures = [estimate_signature(estimate, prior) for estimate in estimates]
        warnings = {*check_one_hand(signatures), *(said for estimate in estimates for said in estimate.warnings)}
        views = zip(files, estimates, strict=True)
        warnings |= {f"{file}: {how_sure(view)}; omad estimate says why" for file, view in views if view.doubtful}
        signature = fuse(signatures)
        hits = index.search_objects(signature, self.count, self.by_information)
        unit = "std" if self.by_information else UNITS[index.space.metric]
        picture = self.output / "ranking.png"
        earlier = self.output.glob("ranking-[0-9]*.png") if picture.is_file() else ()  # which may have named more
        with replacing(file for file in earlier if re.fullmatch(r"ranking-\d{2,3}", file.stem)):
            save(ranking_figure(observations, hits, unit), picture)
            thumbnails = (self.output / f"ranking-{number:02d}.png" for number in range(1, len(hits) + 1))
            ranking = [*map(self._ranked, hits, thumbnails)]
        if signature.of_other_hand is not None and all(hit.entry.of_other_hand is None for hit in hits):
            cure = "build it anew, or its mirror image counts as the object"
            warnings.add(f"hand: {self.index} says of none of these which hand it is of; {cure}")
        record = {"inputs": [*map(str, files)], "index": str(self.index), "category": index.space.category}
        record |= {"unit": unit, "ranking": ranking, "picture": str(picture), "warnings": sorted(warnings)}
        return Answer(record, ranking_text)

    def _ranked(self, hit: Hit, path: Path) -> dict[str, Any]:
        """An object's line in the ranking; its thumbnail is written."""
        entry = hit.entry
        if entry.thumbnail:
            write_atomic(path, lambda temporary: temporary.write_bytes(entry.thumbnail))
        found = {"object": entry.name, "distance": hit.distance, "mirrored": hit.mirrored, "source": entry.source}
        return found | {"thumbnail": str(path) if entry.thumbnail else None}


def ranking_text(answer: dict[str, Any]) -> str:
    """What was found, a line an object, whose name may hold what would break it."""
    rows = [["", "object", "distance", "source"]]
    for number, found in enumerate(answer["ranking"], 1):
        distance = f"{found['distance']:.4g} {answer['unit']}{MIRRORED * bool(found['mirrored'])}"
        rows.append([str(number), as_line(found["object"]), distance, as_line(found["source"])])
    return "\n".join([table(rows), f"picture: {answer['picture']}", *answer["warnings"]])
