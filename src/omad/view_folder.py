"""Standard views on disk: rendered once, read by anyone.

    <folder>/dataset.json              category, camera, depth_scale (metres per stored integer), seed, noise, views
    <folder>/<object>/object.json      axes, pivots, limits, part_boxes (``standard_views.ObjectTruth``)
    <folder>/<object>/00000.json       states, T_camera_base, seed; written last, so it marks a whole view
    <folder>/<object>/00000.depth.png  16 bit, 0 = no measurement
    <folder>/<object>/00000.labels.png 8 bit part index, 255 = nothing

Every file depends on the arguments alone: not on the number of processes, nor on interruptions.
"""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from PIL import Image
from tqdm import tqdm

from .camera import STANDARD_CAMERA, Camera
from .categories import Category
from .depth_noise import NoiseLevel
from .errors import InputError
from .files import read_depth, write_atomic
from .objects import ObjectModel
from .standard_views import ObjectTruth, View, standard_view, view_seed

FORMAT = "omad-views-1"
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

    def __len__(self) -> int:
        return self.views

    def __iter__(self) -> Iterator[View]:
        truths = [_read_truth(self.path / name) for name in self.objects]
        for index in range(self.views):
            _, which, number = view_seed(index, len(self.objects), self.seed)
            yield self._read(truths[which], number)

    def _read(self, truth: ObjectTruth, number: int) -> View:
        stem = self.path / truth.name / f"{number:05d}"
        record = _read_json(stem.with_suffix(".json"), "states", "T_camera_base", "seed")
        depth = read_depth(stem.with_suffix(".depth.png"), self.depth_scale)
        try:
            with Image.open(stem.with_suffix(".labels.png")) as image:
                labels = np.asarray(image)
        except OSError as error:
            raise InputError(f"{stem}.labels.png: not readable; delete {stem}.json and render again") from error
        if depth.shape != labels.shape or depth.shape != (self.camera.height, self.camera.width):
            raise InputError(f"{stem}: image sizes do not fit the camera; delete {stem}.json and render again")
        states, pose = np.array(record["states"]), np.array(record["T_camera_base"])
        return View(truth, depth, labels, self.camera, states, pose, tuple(record["seed"]))


def is_view_folder(folder: str | Path) -> bool:
    """Whether ``render_to_folder`` made, or began, this folder."""
    return (Path(folder) / "dataset.json").is_file()


def open_views(folder: str | Path) -> ViewFolder:
    """A folder that ``render_to_folder`` made. Raises InputError where it is none, or is not finished."""
    path = Path(folder)
    record = _read_json(
        path / "dataset.json",
        "format",
        "category",
        "camera",
        "depth_scale",
        "seed",
        "noise",
        "objects",
        "views",
        "finished",
    )
    if record["format"] != FORMAT:
        raise InputError(f"{path}: format {record['format']!r} is not {FORMAT}; render it again")
    if not record["finished"]:
        raise InputError(f"{path}: rendering was interrupted; give the same render command again to finish it")
    return ViewFolder(
        path=path,
        category=record["category"],
        camera=Camera(**record["camera"]),
        depth_scale=record["depth_scale"],
        seed=record["seed"],
        noise=NoiseLevel(**record["noise"]) if record["noise"] else None,
        objects=tuple(record["objects"]),
        views=record["views"],
    )


def read_views(folder: str | Path) -> Iterator[View]:
    """All views of a folder that ``render_to_folder`` made, in the order they were drawn."""
    return iter(open_views(folder))


def render_to_folder(
    models: Sequence[ObjectModel],
    category: Category,
    folder: str | Path,
    views: int,
    seed: int = 0,
    noise: NoiseLevel | None = None,
    processes: int = 1,
    progress: bool = False,
) -> ViewFolder:
    """Write ``views`` standard views of the models; what is already there from the same arguments is kept.

    Raises InputError for a folder made with other arguments (only ``views`` may differ) and for unfit model names.
    """
    path = Path(folder)
    names = [model.name for model in models]
    if not names or len(set(names)) < len(names):
        raise InputError(f"{path}: rendering needs object models, each with a name of its own; got {names}")
    if any(Path(name).name != name for name in names):
        raise InputError(f"{path}: an object's name becomes a folder's name; rename one of {names}")
    scale = _depth_scale(category)
    record = {
        "format": FORMAT,
        "category": category.name,
        "camera": asdict(STANDARD_CAMERA),
        "depth_scale": scale,
        "seed": seed,
        "noise": asdict(noise) if noise else None,
        "objects": names,
    }
    _check_same(path, record, models)
    write_json(path / "dataset.json", {**record, "views": views, "finished": False})
    for model in models:
        write_json(path / model.name / "object.json", _truth_record(ObjectTruth.of(model)))

    draw_missing(_Job(path, tuple(models), category, noise, scale), views, seed, processes, progress)
    write_json(path / "dataset.json", {**record, "views": views, "finished": True})
    return open_views(path)


class ViewJob(Protocol):
    """Draws views and writes their files; sent to every process that helps."""

    @property
    def models(self) -> tuple[ObjectModel, ...]:
        """Of which views are drawn."""
        ...

    def marker(self, seed: tuple[int, int, int]) -> Path:
        """The file of a view that is written last: where it exists, the view is whole."""
        ...

    def write(self, seed: tuple[int, int, int]) -> None:
        """Draw one view and write its files."""
        ...


def draw_missing(job: ViewJob, views: int, seed: int, processes: int = 1, progress: bool = False) -> None:
    """Write those of ``views`` views, dealt out to the job's models in turn, that are not there yet."""
    seeds = [view_seed(index, len(job.models), seed) for index in range(views)]
    missing = [drawn for drawn in seeds if not job.marker(drawn).exists()]
    with tqdm(total=views, initial=views - len(missing), desc="views", disable=not progress) as bar:
        for _ in _run(job, missing, processes):
            bar.update()


@dataclass(frozen=True)
class _Job:
    path: Path
    models: tuple[ObjectModel, ...]
    category: Category
    noise: NoiseLevel | None
    depth_scale: float

    def marker(self, seed: tuple[int, int, int]) -> Path:
        return self.path / self.models[seed[1]].name / f"{seed[2]:05d}.json"

    def write(self, seed: tuple[int, int, int]) -> None:
        """Draw one view and write its three files, the JSON last."""
        model = self.models[seed[1]]
        view = standard_view(model, self.category, seed, self.noise)
        target = self.marker(seed)
        stored = np.rint(view.depth / self.depth_scale)
        stored = np.where(stored < 2**16, stored, 0).astype(np.uint16)
        write_png(target.with_suffix(".depth.png"), stored)
        write_png(target.with_suffix(".labels.png"), view.labels)
        write_json(
            target, {"states": view.states.tolist(), "T_camera_base": view.T_camera_base.tolist(), "seed": view.seed}
        )


_job: ViewJob | None = None
"""In a worker process, what it works on: sent once, not with every view."""


def _start_worker(job: ViewJob) -> None:
    global _job
    _job = job
    torch.set_num_threads(1)


def _work(seed: tuple[int, int, int]) -> None:
    assert _job is not None
    _job.write(seed)


def _run(job: ViewJob, seeds: list[tuple[int, int, int]], processes: int) -> Iterator[None]:
    if processes <= 1 or len(seeds) < 2:
        yield from map(job.write, seeds)
        return
    # fork would copy the locks of running threads
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context, _start_worker, (job,)) as pool:
        yield from pool.map(_work, seeds, chunksize=8)


def _depth_scale(category: Category) -> float:
    """Tenths of millimetres, or the next power of ten that reaches the farthest standard view in 16 bits."""
    scale = 1e-4
    while REACH * category.metres_per_unit > scale * (2**16 - 1):
        scale *= 10
    return scale


def _check_same(path: Path, record: dict[str, Any], models: Sequence[ObjectModel]) -> None:
    """Refuse to mix views of other settings or other models into a folder."""
    if not (path / "dataset.json").exists():
        return
    before = _read_json(path / "dataset.json")
    for key, value in record.items():
        if before.get(key) != value:
            raise InputError(f"{path}: already holds views with another {key}; choose another folder or delete it")
    for model in models:
        file = path / model.name / "object.json"
        if file.exists() and _read_json(file) != _truth_record(ObjectTruth.of(model)):
            raise InputError(f"{path}: already holds another object {model.name}; choose another folder or delete it")


def _truth_record(truth: ObjectTruth) -> dict[str, Any]:
    return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in vars(truth).items()}


def _read_truth(folder: Path) -> ObjectTruth:
    record = _read_json(folder / "object.json", "name", "axes", "pivots", "limits", "part_boxes")
    name = record.pop("name")
    return ObjectTruth(name, **{key: np.array(value) for key, value in record.items()})


def _read_json(path: Path, *keys: str) -> dict[str, Any]:
    try:
        record = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: missing or not JSON; give a folder made by omad render") from error
    if not isinstance(record, dict) or not set(keys) <= record.keys():
        raise InputError(f"{path}: lacks one of {', '.join(keys)}; give a folder made by omad render")
    return record


def write_json(path: Path, record: dict[str, Any]) -> None:
    """On one line, whole or not at all."""
    write_atomic(path, lambda temporary: temporary.write_text(json.dumps(record) + "\n"))


def write_png(path: Path, image: np.ndarray) -> None:
    """8 or 16 bit, whole or not at all."""
    write_atomic(path, lambda temporary: Image.fromarray(image).save(temporary, "PNG", compress_level=1))
