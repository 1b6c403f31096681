"""Standard views on disk: rendered once, read by anyone.

    <folder>/dataset.json              format, category, camera, depth_scale (metres per stored integer), objects,
                                       views; and where they are not the default seed, noise, finished (false as long
                                       as it is being made), clutter (true: see below)
    <folder>/<object>/object.json      axes, pivots, limits, part_boxes (``standard_views.ObjectTruth``), and
                                       of_other_hand: true of a model that was imported as its mirror image
    <folder>/<object>/00000.json       states, T_camera_base, seed; written last, so it marks a whole view
    <folder>/<object>/00000.depth.png  16 bit, 0 = no measurement
    <folder>/<object>/00000.labels.png 8 bit part index, 255 = nothing

With clutter the views are of scenes as cameras see them (``spoils``); what is wrong with each, its ``spoil`` says:

    <folder>/<object>/00000.json           also camera, which differs from view to view, and spoil
    <folder>/<object>/00000.mask.png       255 where the object is said to be, rightly or not;
                                           without the file, where it is labelled
    <folder>/<object>/00000.instances.png  0 table or wall, 1 the object, from 2 other things, 255 = nothing

Every file depends on the arguments alone: not on the number of processes, nor on interruptions.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch

from omad.common import batches
from omad.common.errors import InputError
from omad.common.files import stamp, write_json
from omad.common.incoming import decoded, is_file, read_image, read_json, read_record
from omad.common.processes.workers import helpers
from omad.common.stderr import tell
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.sensing.depth_files import read_depth

from ..broken import Broken, passing_over
from .depth_noise import NoiseLevel
from .misplaced import CHECK, is_misplaced
from .rasteriser import NOTHING
from .spoils.spoiling import cluttered
from .standard_views import ObjectTruth, View, ViewSeed, standard_view, view_seed
from .stored_images import where_stored, write_depth, write_png
from .view_records import FORMAT, DatasetRecord, ObjectRecord, ViewRecord, check_truth

DATASET = "dataset.json"
CURE = "give a folder as omad render makes it"
REACH = 11.0
"""No standard view of an object is farther than this, in category units."""


@dataclass(frozen=True)
class ViewFolder:
    """A folder of standard views; iterate over it for its views, in the order they were drawn."""

    path: Path
    category: str
    camera: Camera
    depth_scale: float
    """Metres per stored integer."""
    seed: int
    noise: NoiseLevel | None
    objects: tuple[str, ...]
    views: int
    clutter: bool = False
    broken: Broken = "refuse"
    spec: Category | None = None
    """Of its objects; None: they have as many joints as they say."""
    left_out: list[dict[str, str]] = field(default_factory=list)
    """{"name": of the view or object, "reason": one line}; grows while views are read."""
    by_object: bool = False
    """Views of one object come together: not in the order they were drawn."""
    told: list[str] = field(default_factory=list)
    """What a person was told of all views."""

    def __len__(self) -> int:
        return self.views

    def __iter__(self) -> Iterator[View]:
        return self.after(0)

    @property
    def stamp(self) -> str:
        """Another one when a view was written anew."""
        files = (self._stem(view_seed(i, len(self.objects), self.seed)).with_suffix(".json") for i in range(self.views))
        told = "\n".join(stamp(file) if file.is_file() else "" for file in files)
        return hashlib.sha256(told.encode()).hexdigest()

    def after(self, skip: int) -> Iterator[View]:
        """Without the first so many, which are not read where none may be broken."""
        if self.broken == "refuse":
            return self._whole(skip)
        return islice(self._whole(0), skip, None)

    def _whole(self, first: int) -> Iterator[View]:
        truths: dict[int, ObjectTruth] = {}
        for number, name in enumerate(self.objects[: self.views]):
            with passing_over(self.broken, self.left_out, name):
                truths[number] = _read_truth(self.path / name, self.spec)
        yield from self._placed(self._views(truths, first))

    def _views(self, truths: dict[int, ObjectTruth], first: int) -> Iterator[View]:
        order, count = range(self.views), len(self.objects)
        if self.by_object:
            order = [index for number in range(count) for index in range(number, self.views, count)]
        for index in order[first:]:
            seed, view = view_seed(index, len(self.objects), self.seed), None
            if (truth := truths.get(seed[1])) is None:
                continue
            with passing_over(self.broken, self.left_out, f"{truth.name}/{seed[2]:05d}"):
                view = self._read(truth, seed)
            if view is not None:
                yield view

    def _placed(self, views: Iterator[View]) -> Iterator[View]:
        """The same; at the end, or where a reader stops, it is told once if most of them cannot be right."""
        whole = misplaced = 0
        try:
            for view in views:
                whole += 1
                misplaced += self.spec is not None and is_misplaced(view, self.spec)
                yield view
        finally:
            if 2 * misplaced > whole and not self.told:  # of single ones the depth may be wrong
                self.told.append(f"in {misplaced} of {whole} views a part is not where its pixels are; check {CHECK}")
                tell(f"{self.path}: {self.told[0]}")

    def _stem(self, seed: ViewSeed) -> Path:
        """Of a view's files."""
        return self.path / self.objects[seed[1]] / f"{seed[2]:05d}"

    def _read(self, truth: ObjectTruth, seed: ViewSeed) -> View:
        stem = self._stem(seed)
        record = read_record(ViewRecord, stem.with_suffix(".json"), CURE)
        depth = read_depth(stem.with_suffix(".depth.png"), self.depth_scale)
        labels = read_image(file := stem.with_suffix(".labels.png"), file)
        camera = self.camera if record.camera is None else record.camera
        mask_file = stem.with_suffix(".mask.png")
        mask = read_image(mask_file, mask_file) > 0 if mask_file.exists() else None
        images = [depth, labels] if mask is None else [depth, labels, mask]
        for image in images:
            if image.shape != (camera.height, camera.width):
                sizes = f"an image of {image.shape[::-1]} pixels for a camera of {camera.width, camera.height}"
                raise InputError(f"{stem}: {sizes}; give all images the camera's size, or render the view again")
        if len(record.states) != len(truth.axes):
            raise InputError(f"{stem}.json: states: {len(record.states)} for {len(truth.axes)} joints; {CURE}")
        try:
            check_truth(record, truth, camera, depth, labels)
        except ValueError as error:
            raise InputError(f"{stem}: {error}") from error
        seed = seed if record.seed is None else record.seed
        if mask is None and depth[labels == NOTHING].any():  # a frame of one's own, which shows more than the object
            mask = labels != NOTHING
        return View(truth, depth, labels, camera, record.states, record.T_camera_base, seed, mask)


def is_view_folder(folder: str | Path) -> bool:
    """Whether ``render_to_folder`` made, or began, this folder."""
    return is_file(Path(folder) / DATASET)


def open_views(folder: str | Path, broken: Broken = "refuse", category: Category | None = None) -> ViewFolder:
    """A folder that ``render_to_folder`` made. Raises InputError where it is none, is not of the ``category``, if one
    is given, or is not finished; while its views are read, at the first broken file, or with ``broken="skip"`` leaves
    out the view or the object that it belongs to, says so on stderr, and lists it."""
    path = Path(folder)
    values = read_json(path / DATASET, CURE)
    found = values.get("format") if isinstance(values, dict) else None
    if found != FORMAT:
        raise InputError(f"{path / 'dataset.json'}: format {found!r} is not {FORMAT}; give that, or render it again")
    record = decoded(DatasetRecord, values, path / DATASET, CURE)
    if not record.finished:
        raise InputError(f"{path}: rendering was interrupted; give the same render command again to finish it")
    if category is not None and record.category != category.name:
        raise InputError(f"{path}: views of {record.category}, not of {category.name}")
    for name in record.objects:
        if not _is_folder_name(name):
            raise InputError(f"{path / 'dataset.json'}: objects: {name!r} is no folder's name; {CURE}")
    made = {each.name: getattr(record, each.name) for each in fields(ViewFolder) if hasattr(record, each.name)}
    return ViewFolder(path, **made, broken=broken, spec=category)


def _is_folder_name(name: str) -> bool:
    """Of one folder within another."""
    return name not in ("", "..") and Path(name).name == name and "\0" not in name


def render_to_folder(
    models: Sequence[ObjectModel],
    category: Category,
    folder: str | Path,
    views: int,
    seed: int = 0,
    noise: NoiseLevel | None = None,
    processes: int = 1,
    progress: bool = False,
    clutter: bool = False,
) -> ViewFolder:
    """Write ``views`` standard views of the models, or with ``clutter`` scenes spoilt at random, which have their own
    noise; what is already there from the same arguments is kept. Raises InputError for a folder made with other
    arguments (only ``views`` may be more) and for unfit model names."""
    path = Path(folder)
    names = [model.name for model in models]
    if not names or len(set(names)) < len(names):
        raise InputError(f"{path}: rendering needs object models, each with a name of its own; got {names}")
    if not all(map(_is_folder_name, names)):
        raise InputError(f"{path}: an object's name becomes a folder's name; rename one of {names}")
    scale, dataset = depth_scale_of(category), path / DATASET
    camera = _camera_record(STANDARD_CAMERA)
    record = {"format": FORMAT, "category": category.name, "camera": camera, "depth_scale": scale, "seed": seed}
    record |= {"noise": asdict(noise) if noise else None, "objects": names}
    record["viewpoints"] = json.loads(json.dumps(asdict(category.views)))
    truths = {path / model.name / "object.json": _truth_record(model) for model in models[:views]}
    if dataset.exists():  # views of other settings or other models are not mixed
        usual = {"clutter": False, "viewpoints": record["viewpoints"]}
        before = _read_json(dataset)
        refuse_others(path, {**usual, **before}, record | {"clutter": clutter})
        if (kept := before.get("views")) and kept > views:
            raise InputError(f"{path}: was made for {kept} views, which are more; give as many, or another folder")
        for file, truth in truths.items():
            # earlier versions did not write all of it
            if file.exists() and not _read_json(file).items() <= truth.items():
                raise InputError(f"{path}: already holds another object {truth['name']}; choose another folder")
    record |= {"clutter": True} if clutter else {}
    write_json(dataset, {**record, "views": views, "finished": False})
    for file, truth in truths.items():
        write_json(file, truth)

    file_of = partial(_view_file, path, names)
    make = partial(make_standard, tuple(models), category, noise, file_of, partial(_write_view, scale))
    if clutter:
        make = partial(_make_cluttered, tuple(models), category, file_of, scale)
    draw_missing(make, file_of, len(models), views, seed, processes, progress)
    write_json(dataset, {**record, "views": views, "finished": True})
    return open_views(path)


def _view_file(folder: Path, names: Sequence[str], seed: ViewSeed) -> Path:
    return folder / names[seed[1]] / f"{seed[2]:05d}.json"


def _write_view(depth_scale: float, view: View, file: Path, **more: Any) -> None:
    """``more`` goes into the record."""
    write_depth(file.with_suffix(".depth.png"), view.depth, depth_scale)
    write_png(file.with_suffix(".labels.png"), where_stored(view.labels, view.depth, depth_scale))
    pose = {"states": view.states.tolist(), "T_camera_base": view.T_camera_base.tolist()}
    write_json(file, {**pose, "seed": view.seed, **more})


def make_standard(
    models: Sequence[ObjectModel],
    category: Category,
    noise: NoiseLevel | None,
    file_of: Callable[[ViewSeed], Path],
    write: Callable[[View, Path], None],
    seed: ViewSeed,
) -> None:
    """Draw a standard view and ``write`` it."""
    write(standard_view(models[seed[1]], category, seed, noise), file_of(seed))


def _make_cluttered(
    models: Sequence[ObjectModel],
    category: Category,
    file_of: Callable[[ViewSeed], Path],
    depth_scale: float,
    seed: ViewSeed,
) -> None:
    spoil, made = cluttered(models[seed[1]], category, seed)
    file, view = file_of(seed), made.view
    if view.mask is not None:
        write_png(file.with_suffix(".mask.png"), view.mask.astype(np.uint8) * 255)
    write_png(file.with_suffix(".instances.png"), where_stored(made.instances, view.depth, depth_scale))
    _write_view(depth_scale, view, file, camera=_camera_record(view.camera), spoil=asdict(spoil))


def _camera_record(camera: Camera) -> dict[str, Any]:
    return {key: value for key, value in vars(camera).items() if value is not None}


def draw_missing(
    make: Callable[[ViewSeed], None],
    file_of: Callable[[ViewSeed], Path],
    objects: int,
    views: int,
    seed: int,
    processes: int = 1,
    progress: bool = False,
) -> None:
    """``make`` those of ``views`` views, dealt out to the objects in turn, that are not there yet. The file that it
    writes last is ``file_of`` the view's seed: where that exists, the view is whole. It is sent to the processes that
    help."""
    seeds = [view_seed(index, objects, seed) for index in range(views)]
    missing = [drawn for drawn in seeds if not file_of(drawn).exists()]
    drawn = _run(make, missing, processes)
    for _ in batches.progress(drawn, views, done=views - len(missing), every=30.0) if progress else drawn:
        pass


_drawing: Callable[[ViewSeed], None]
"""In a worker process, what it works on: sent once, not with every view."""


def _start_worker(drawing: Callable[[ViewSeed], None]) -> None:
    global _drawing
    _drawing = drawing
    torch.set_num_threads(1)


def _work(seed: ViewSeed) -> None:
    _drawing(seed)


def _run(draw: Callable[[ViewSeed], None], seeds: list[ViewSeed], processes: int) -> Iterator[None]:
    if processes <= 1 or len(seeds) < 2:
        yield from map(draw, seeds)
        return
    with helpers(min(processes, len(seeds)), _start_worker, draw) as pool:
        yield from pool.map(_work, seeds, chunksize=min(8, -(-len(seeds) // processes)))


def depth_scale_of(category: Category) -> float:
    """Metres per stored integer: tenths of millimetres, or the next power of ten that reaches the farthest standard
    view in 16 bits."""
    scale = 1e-4
    while REACH * category.metres_per_unit > scale * (2**16 - 1):
        scale *= 10
    return scale


def refuse_others(path: Path, before: dict[str, Any], record: dict[str, Any]) -> None:
    """Raises InputError where what was written ``before`` differs from ``record`` in one of its keys."""
    for key, value in record.items():
        if before.get(key) != value:
            raise InputError(f"{path}: was made with other {key}; choose another folder, or delete it")


def _truth_record(model: ObjectModel) -> dict[str, Any]:
    truth = {**vars(ObjectTruth.of(model))}
    if not model.of_other_hand:
        del truth["of_other_hand"]
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in truth.items()}


def _read_truth(folder: Path, spec: Category | None) -> ObjectTruth:
    file = folder / "object.json"
    record = read_record(ObjectRecord, file, CURE)
    if spec is not None and (joints := len(spec.joints)) != len(record.axes):
        raise InputError(
            f"{file}: axes: of {len(record.axes)} joints, where the category has {joints}; render it again"
        )
    if not len(record.axes) == len(record.pivots) == len(record.limits) == len(record.part_boxes) - 1:
        raise InputError(f"{file}: axes, pivots, limits and part_boxes are of different numbers of joints; {CURE}")
    if record.name not in (None, folder.name):
        raise InputError(f"{file}: name: is not the folder's; {CURE}")
    return ObjectTruth(**vars(replace(record, name=folder.name)))


def _read_json(path: Path) -> dict[str, Any]:
    record = read_json(path, CURE)
    if not isinstance(record, dict):
        raise InputError(f"{path}: holds no table; {CURE}")
    return record
