"""What estimators say of views, kept on disk with a record of what it was made of.

<cache>/<category>/truth.npz       objects, part boxes and true poses, and which data they are of
<cache>/<category>/<method>.npz    poses before and after refinement, and times; which data, weights and settings
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from tqdm import tqdm

from ..categories import Category
from ..errors import InputError
from ..evaluation import true_pose
from ..files import make_folder, write_atomic
from ..metrics import ObjectPose
from ..observation import Observation
from ..sources.select import ViewSource
from ..standard_views import View

Identity = dict[str, str]


class Answer(Protocol):
    """An estimate, as far as metrics ask."""

    def initial_pose(self) -> ObjectPose: ...
    def pose(self) -> ObjectPose: ...
    @property
    def seconds(self) -> Mapping[str, float]: ...


Estimate = Callable[[Observation], Answer]
"""An estimator of one observation."""


@dataclass(frozen=True)
class Truths:
    """The V views that predictions are of; metres and radians."""

    objects: np.ndarray
    """(V,) names."""
    boxes: np.ndarray
    """(V, K, 2, 3) part boxes at rest."""
    poses: tuple[ObjectPose, ...]


@dataclass(frozen=True)
class Predictions:
    """What one estimator says of V views; NaN is missing."""

    initial: tuple[ObjectPose, ...]
    refined: tuple[ObjectPose, ...]
    seconds: np.ndarray
    """(V, 3) of network, refinement, and all together; one image at a time. NaN where there was nothing to estimate."""
    machine: str
    """What the times are of."""


def this_machine() -> str:
    """Processor and threads, as predictions record them."""
    return f"{platform.processor() or platform.machine()}, {torch.get_num_threads()} thread(s)"


def weights_identity(folder: Path) -> str:
    """Tells one checkpoint from another."""
    digest = hashlib.sha256()
    for name in ("config.json", "model.safetensors"):
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()[:16]


def data_identity(first: Sequence[View], source: str, settings: Mapping[str, Any]) -> str:
    """Tells one set of views from another: the settings that made it, what the ``first`` of them show, and for a folder
    which files of what size are in it."""
    digest = hashlib.sha256(json.dumps(dict(settings), sort_keys=True).encode())
    for view in first:
        digest.update(np.ascontiguousarray(view.depth).tobytes())
        digest.update(np.concatenate([view.states, view.T_camera_base.ravel()]).tobytes())
    folder = Path(source)
    if folder.is_dir():
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            digest.update(f"{path.relative_to(folder)} {path.stat().st_size}\n".encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class Method:
    """Something that estimates, and what its answers depend on."""

    estimate: Estimate
    made_of: Identity


def kept_or_made(
    cache: Path, data: Identity, methods: Mapping[str, Method], category: Category, load: Callable[[], ViewSource]
) -> tuple[Truths, dict[str, Predictions]]:
    """From the ``cache`` as far as they are there; the rest is made, all methods in turn on each view, and put there.

    Raises InputError where the cache is of other data, weights or settings.
    """
    make_folder(cache)
    truths = load_truths(cache / "truth.npz", data)
    kept = {name: load_predictions(cache / f"{name}.npz", data | m.made_of) for name, m in methods.items()}
    said = {name: found for name, found in kept.items() if found is not None}
    missing = {name: method.estimate for name, method in methods.items() if name not in said}
    if truths is None or missing:
        source = load()
        truths, new = predict(source.views, source.total, category, missing)
        save_truths(cache / "truth.npz", truths, data)
        for name, found in new.items():
            save_predictions(cache / f"{name}.npz", found, data | methods[name].made_of)
        said |= new
    return truths, said


def predict(
    views: Iterable[View], total: int, category: Category, estimators: Mapping[str, Estimate]
) -> tuple[Truths, dict[str, Predictions]]:
    """Run every estimator on every view, one at a time."""
    seen: list[View] = []
    answers: dict[str, list[tuple[Answer | None, float]]] = {name: [] for name in estimators}
    for view in tqdm(views, total=total, unit="view", file=sys.stderr, disable=not sys.stderr.isatty()):
        seen.append(_without_images(view))
        try:
            observation = Observation.from_depth(view.depth, view.camera)
        except InputError:  # too little of the object is left to be seen
            observation = None
        for name, estimate in estimators.items():
            if observation is None:
                answers[name].append((None, np.nan))
                continue
            if len(seen) == 1:
                estimate(observation)  # the first call compiles and allocates
            began = time.perf_counter()
            answer = estimate(observation)
            answers[name].append((answer, time.perf_counter() - began))
    truths = Truths(
        objects=np.array([view.object for view in seen]),
        boxes=np.stack([view.truth.part_boxes for view in seen]),
        poses=tuple(true_pose(view, category) for view in seen),
    )
    nothing = _nothing(category)
    return truths, {
        name: Predictions(
            initial=tuple(answer.initial_pose() if answer else nothing for answer, _ in said),
            refined=tuple(answer.pose() if answer else nothing for answer, _ in said),
            seconds=np.array(
                [
                    [*(answer.seconds[k] for k in ("network", "refinement")), s] if answer else [np.nan] * 3
                    for answer, s in said
                ]
            ),
            machine=this_machine(),
        )
        for name, said in answers.items()
    }


def _without_images(view: View) -> View:
    empty = np.zeros((0, 0))
    return View(view.truth, empty, empty, view.camera, view.states, view.T_camera_base, view.seed)


def _nothing(category: Category) -> ObjectPose:
    joints, parts = len(category.joints), len(category.parts)
    shapes = (joints,), (joints, 3), (joints, 3), (parts, 4, 4)
    return ObjectPose(*(np.full(shape, np.nan) for shape in shapes))


def save_truths(path: Path, truths: Truths, identity: Identity) -> None:
    save_arrays(path, identity, objects=truths.objects, boxes=truths.boxes, **_arrays("pose", truths.poses))


def load_truths(path: Path, identity: Identity) -> Truths | None:
    """None where there is no such file. Raises InputError where it is of other data."""
    arrays = load_arrays(path, identity)
    return None if arrays is None else Truths(arrays["objects"], arrays["boxes"], _poses("pose", arrays))


def save_predictions(path: Path, said: Predictions, identity: Identity) -> None:
    poses = _arrays("initial", said.initial) | _arrays("refined", said.refined)
    save_arrays(path, identity, seconds=said.seconds, machine=np.array(said.machine), **poses)


def load_predictions(path: Path, identity: Identity) -> Predictions | None:
    """None where there is no such file. Raises InputError where it is of other data, weights or settings."""
    arrays = load_arrays(path, identity)
    if arrays is None:
        return None
    seconds, machine = arrays["seconds"], str(arrays["machine"])
    return Predictions(_poses("initial", arrays), _poses("refined", arrays), seconds, machine)


def _arrays(prefix: str, poses: Sequence[ObjectPose]) -> dict[str, np.ndarray]:
    return {f"{prefix}_{f.name}": np.stack([getattr(pose, f.name) for pose in poses]) for f in fields(ObjectPose)}


def _poses(prefix: str, arrays: dict[str, np.ndarray]) -> tuple[ObjectPose, ...]:
    columns = [arrays[f"{prefix}_{f.name}"] for f in fields(ObjectPose)]
    return tuple(ObjectPose(*row) for row in zip(*columns, strict=True))


def save_arrays(path: Path, identity: Identity, **arrays: np.ndarray) -> None:
    """Whole or not at all, with a record of what it was made of."""

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, identity=json.dumps(identity), **arrays)

    write_atomic(path, write)


def load_arrays(path: Path, identity: Identity) -> dict[str, np.ndarray] | None:
    """What ``save_arrays`` wrote; None where there is no such file. Raises InputError for another identity."""
    if not path.is_file():
        return None
    try:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        found = json.loads(str(arrays.pop("identity")))
    except Exception as error:  # a damaged archive raises anything
        raise InputError(f"{path}: not a cache of predictions; delete it, or give another --cache") from error
    for name, value in identity.items():
        if found.get(name) != value:
            raise InputError(f"{path}: made with other {name}; delete it, or give another --cache")
    return arrays
