"""Train the networks that tell categories, and objects from their mirror images, by images of their fronts."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import cross_entropy, softplus

from omad.common.arrays import digest_of
from omad.common.batches import progress
from omad.common.errors import InputError
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.spoils.thinned import some_points, thinly_spoilt
from omad.data.rendering.standard_views import View, standard_view
from omad.model.fronts.hands import HandNet
from omad.model.fronts.image import MOST, front_image
from omad.model.fronts.network import FrontNet
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .loop import Schedule, Training, train

STRETCHED = 0.5
"""Share of the objects whose proportions are changed: real ones are unlike those trained on."""
STRETCH = 0.15
"""Standard deviation of the logarithm of each side."""
PLACED = 2
"""How often a view is looked at, each time with another error of the object's place."""
SPARSE = 0.4
"""Share of these looks that see a part of the points alone."""
LEAST, LARGEST = 0.3, 2.0
"""Factors of these errors: most estimates are near the truth, some are not."""
TURNED, MOVED, SIZED = np.radians(1.5), 0.02, 0.03
"""Standard deviations of an estimate's errors: about each axis; along it and of the size, shares of the body's."""
STREAM = 2
"""Behind a view's seed, random numbers of this file's own, apart from the view's and its spoil's."""
STEPS = 127 / MOST
"""Of an image's values, as they are kept."""


@dataclass(frozen=True)
class FrontTraining(Training):
    """Settings of the training that tells categories."""

    schedule: Schedule = Schedule(steps=8000, batch=128, learning_rate=3e-3, weight_decay=1e-2)


@dataclass(frozen=True)
class HandTraining(Training):
    """Settings of the training that tells hands."""

    schedule: Schedule = Schedule(steps=2600, batch=64, learning_rate=3e-3, weight_decay=1e-2)


def front_images(models: Sequence[ObjectModel], category: Category, views: int, seed: int) -> np.ndarray:
    """(n, 5, ROWS, COLUMNS) int8, ``STEPS`` of them one: fronts of the ``models`` in so many views, clean and spoilt by
    turns, of all their points or few, of places that are wrong by as much as an estimate is. The same for the same
    arguments. Raises InputError where none of the views shows enough."""
    made = []
    for index in progress(range(views), views, every=30.0):
        rng = np.random.default_rng((seed, index, STREAM))
        view = _view(models[index % len(models)], category, (seed, index), rng)
        observed = None if view is None else view.observed()
        if view is None or observed is None:
            continue
        for _ in range(PLACED):
            place = _misplaced(view.T_camera_base, view.truth.part_boxes[0], rng)
            points = observed.points
            if rng.random() < SPARSE:
                points = points[some_points(len(points), rng)]
            made.append(np.rint(STEPS * front_image(points, *place)).astype(np.int8))
    if not made:
        raise InputError(f"{category.name}: too little of it is seen in {views} view(s); give more")
    return np.stack(made)


def _view(model: ObjectModel, category: Category, seed: tuple[int, int], rng: np.random.Generator) -> View | None:
    """None where such a view shows too little."""
    if rng.random() < STRETCHED:
        model = model.stretched(np.exp(rng.normal(0, STRETCH, 3)))
    try:
        if seed[1] % 2:
            return thinly_spoilt(model, category, seed)
        return standard_view(model, category, seed, LEVELS[str(rng.choice(list(LEVELS)))])
    except InputError:
        return None


def _misplaced(T_camera_base: np.ndarray, body: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Where an estimate may say the base is (4, 4), and its ``body`` (2, 3)."""
    off, place = rng.uniform(LEAST, LARGEST), T_camera_base.copy()
    size = body[1] - body[0]
    place[:3, 3] += T_camera_base[:3, :3] @ (off * MOVED * size * rng.normal(size=3))
    place[:3, :3] @= Rotation.from_rotvec(off * TURNED * rng.normal(size=3)).as_matrix()
    return place, body * np.exp(off * SIZED * rng.normal(size=3))


def train_fronts(
    images: Mapping[str, np.ndarray], folder: Path, settings: FrontTraining, device: torch.device | str = "cpu"
) -> FrontNet:
    """Learn to tell the categories whose ``images`` these are, as of ``front_images``; every second one is shown in a
    mirror. Returns the averaged network; ``folder`` as of ``train``."""
    torch.manual_seed(settings.schedule.seed)
    net, kept = FrontNet(list(images)).to(device), _Kept.of(images, device)

    def loss_terms(module: FrontNet, draw: torch.Generator) -> dict[str, Tensor]:
        shown, answers, _ = kept.drawn(settings.schedule.batch, draw)
        return {"category": cross_entropy(module(shown), answers)}

    return train(net, loss_terms, settings.schedule, folder, _config(net, settings, images))


def train_hands(
    images: Mapping[str, np.ndarray], folder: Path, settings: HandTraining, device: torch.device | str = "cpu"
) -> HandNet:
    """The same for the network that tells objects from their mirror images, of categories whose objects may be of
    either hand; the ``images`` are all of their own."""
    torch.manual_seed(settings.schedule.seed)
    net, kept = HandNet(list(images)).to(device), _Kept.of(images, device)

    def loss_terms(module: HandNet, draw: torch.Generator) -> dict[str, Tensor]:
        shown, answers, mirrored = kept.drawn(settings.schedule.batch, draw)
        said = module(shown).gather(1, answers[:, None])[:, 0]
        return {"hand": softplus(torch.where(mirrored, said, -said)).mean()}

    return train(net, loss_terms, settings.schedule, folder, _config(net, settings, images))


@dataclass(frozen=True)
class _Kept:
    """Images of all categories, where the network is."""

    images: Tensor
    """(N, 5, ROWS, COLUMNS) int8."""
    answers: Tensor
    """(N,)."""

    @classmethod
    def of(cls, images: Mapping[str, np.ndarray], device: torch.device | str) -> Self:
        counts = torch.tensor([len(some) for some in images.values()])
        answers = torch.arange(len(images)).repeat_interleave(counts)
        return cls(torch.from_numpy(np.concatenate(list(images.values()))).to(device), answers.to(device))

    def drawn(self, count: int, draw: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """So many at random, their categories, and which are shown in a mirror."""
        device = self.images.device
        rows = torch.randint(len(self.images), (count,), device=device, generator=draw)
        mirrored = torch.rand(count, device=device, generator=draw) < 0.5
        shown = self.images[rows] / STEPS
        return torch.where(mirrored[:, None, None, None], shown.flip(3), shown), self.answers[rows], mirrored


def _config(net: FrontNet | HandNet, settings: Training, images: Mapping[str, np.ndarray]) -> dict[str, Any]:
    return {"kind": net.kind, "names": net.names, "settings": asdict(settings), "images": digest_of(images)}
