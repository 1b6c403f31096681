"""What estimators say of views, kept on disk with a record of what it was made of.

<cache>/<category>/truth.npz       objects, part boxes and true poses, and which data they are of
<cache>/<category>/<method>.npz    poses before and after refinement, and times; which data, weights and settings
"""

import hashlib
import json
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from omad.common.arrays import Identity, load_arrays, save_arrays
from omad.common.batches import progress
from omad.common.errors import InputError
from omad.common.user_cache import kept_at
from omad.data.rendering.standard_views import View, true_pose
from omad.data.source import ViewSource
from omad.objects.category import Category
from omad.objects.pose import ObjectPose
from omad.sensing.observation import Observation


class Answer(Protocol):
    """An estimate, as far as metrics ask."""

    def initial_pose(self) -> ObjectPose: ...
    def pose(self) -> ObjectPose: ...
    @property
    def seconds(self) -> Mapping[str, float]: ...


@dataclass(frozen=True)
class Truths:
    """The V views that predictions are of; metres and radians."""

    objects: np.ndarray
    """(V,) names."""
    boxes: np.ndarray
    """(V, K, 2, 3) part boxes at rest."""
    poses: ObjectPose
    """Of V objects."""


@dataclass(frozen=True)
class Predictions:
    """What one estimator says of V views; NaN is missing."""

    initial: ObjectPose
    """Of V objects."""
    refined: ObjectPose
    seconds: np.ndarray
    """(V, 3) of network, refinement, and all together; one image at a time. NaN where there was nothing to estimate."""
    machine: str
    """What the times are of."""


def this_machine() -> str:
    """Processor and threads, as predictions record them."""
    return f"{platform.processor() or platform.machine()}, {torch.get_num_threads()} thread(s)"


def weights_identity(folder: Path) -> str:
    """Tells one checkpoint from another, and what it says of confidence and surfaces."""
    digest = hashlib.sha256()
    for name in ("config.json", "model.safetensors", "confidence.json", "surfaces.npz"):
        digest.update((folder / name).read_bytes() if (folder / name).is_file() else b"")
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
class Predictor:
    """An estimator of one observation, and what its answers depend on."""

    estimate: Callable[[Observation], Answer]
    made_of: Identity


def kept_or_made(
    cache: Path | None,
    data: Identity,
    predictors: Mapping[str, Predictor],
    category: Category,
    load: Callable[[], ViewSource],
) -> tuple[Truths, dict[str, Predictions]]:
    """From the ``cache`` as far as they are there; the rest is made, all predictors in turn on each view, and put
    there; without one it is the user's. Raises InputError where the cache is of other data, weights or settings."""
    made_of = {"truth": data} | {name: data | predictor.made_of for name, predictor in predictors.items()}
    files = {name: _file(cache, category, name, identity) for name, identity in made_of.items()}
    kept = {name: load_arrays(files[name], identity) for name, identity in made_of.items()}
    arrays = {name: found for name, found in kept.items() if found is not None}
    if len(arrays) < len(kept):
        made = predict(load(), category, {name: p for name, p in predictors.items() if name not in arrays})
        for name, found in made.items():
            save_arrays(files[name], made_of[name], **found)
        arrays |= made
    truth = arrays.pop("truth")
    poses = {name: (_poses("initial", a), _poses("refined", a)) for name, a in arrays.items()}
    said = {name: Predictions(*poses[name], a["seconds"], str(a["machine"])) for name, a in arrays.items()}
    return Truths(truth["objects"], truth["boxes"], _poses("true", truth)), said


def _file(cache: Path | None, category: Category, name: str, made_of: Identity) -> Path:
    kept = kept_at(cache, "predictions", name if cache else f"{category.name}-{name}", made_of)
    return kept.with_name(f"{kept.name}.npz")


def predict(
    source: ViewSource, category: Category, predictors: Mapping[str, Predictor]
) -> dict[str, dict[str, np.ndarray]]:
    """Run every predictor on every view, one at a time; arrays of ``truth``, and of each by its name. Raises InputError
    where there is no view."""
    views: list[tuple[str, np.ndarray]] = []
    poses: dict[str, list[ObjectPose]] = defaultdict(list)
    times: dict[str, list[list[float]]] = defaultdict(list)
    joints, parts = len(category.joints), len(category.parts)
    nothing = ObjectPose(*(np.full(shape, np.nan) for shape in (joints, (joints, 3), (joints, 3), (parts, 4, 4))))
    for view in progress(source.views, source.total):
        views.append((view.object, view.truth.part_boxes))
        poses["true"].append(true_pose(view, category))
        observation = view.observed()
        for name, predictor in predictors.items():
            initial, refined, seconds = nothing, nothing, [np.nan] * 3
            if observation is not None:
                if len(views) == 1:
                    predictor.estimate(observation)  # the first call compiles and allocates
                began = time.perf_counter()
                answer = predictor.estimate(observation)
                total = time.perf_counter() - began
                initial, refined = answer.initial_pose(), answer.pose()
                seconds = [answer.seconds["network"], answer.seconds["refinement"], total]
            poses[f"{name} initial"].append(initial)
            poses[f"{name} refined"].append(refined)
            times[name].append(seconds)
    if not views:
        raise InputError(f"{category.name}: there is no view to look at; give a source that holds some")
    objects, boxes = zip(*views, strict=True)
    arrays = {"truth": {"objects": np.array(objects), "boxes": np.stack(boxes)} | _arrays("true", poses["true"])}
    for name in predictors:
        arrays[name] = {"seconds": np.array(times[name]), "machine": np.array(this_machine())}
        arrays[name] |= _arrays("initial", poses[f"{name} initial"]) | _arrays("refined", poses[f"{name} refined"])
    return arrays


def _arrays(prefix: str, poses: Sequence[ObjectPose]) -> dict[str, np.ndarray]:
    return {f"{prefix}_{name}": column for name, column in vars(ObjectPose.stack(poses)).items()}


def _poses(prefix: str, arrays: Mapping[str, np.ndarray]) -> ObjectPose:
    return ObjectPose(*(arrays[f"{prefix}_{field.name}"] for field in fields(ObjectPose)))
