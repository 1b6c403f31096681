"""Standard views: rendered depth images of object models from random viewpoints, with their truth."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch

from omad.common.errors import InputError
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.rigid import bounding_sphere
from omad.objects.category import Category, ViewRange
from omad.objects.model import ObjectModel, diagonal
from omad.objects.pose import ObjectPose
from omad.sensing.observation import Observation

from .depth_noise import NoiseLevel, add_noise
from .rasteriser import NOTHING, Rendering, render
from .viewpoints import keep_possible, sample_poses, sample_states

MIN_PIXELS = 500
"""A view that shows fewer pixels of the object (before noise) is drawn again."""
ATTEMPTS = 1000

ViewSeed = tuple[int, ...]
"""Seed, object index, view index."""


@dataclass(frozen=True)
class ObjectTruth:
    """What metrics ask of an object model; canonical space, metres and radians."""

    name: str
    axes: np.ndarray
    """(J, 3) unit."""
    pivots: np.ndarray
    """(J, 3)."""
    limits: np.ndarray
    """(J, 2)."""
    part_boxes: np.ndarray
    """(K, 2, 3) low and high corners of each part's box at rest."""
    of_other_hand: bool = False
    """The object is the mirror image of what is shown, as its model was imported so."""

    @classmethod
    def of(cls, model: ObjectModel) -> Self:
        return cls(model.name, model.axes, model.pivots, model.limits, model.part_boxes(), model.of_other_hand)

    @property
    def diagonal(self) -> float:
        """Diagonal of the whole object's rest box in metres."""
        return diagonal(self.part_boxes)


@dataclass(frozen=True)
class View:
    """One depth image of an object, and the truth behind it."""

    truth: ObjectTruth
    depth: np.ndarray
    """(H, W) float32 metres, 0 where there is no measurement."""
    labels: np.ndarray
    """(H, W) uint8 part index, ``NOTHING`` where there is no measurement of the object."""
    camera: Camera
    states: np.ndarray
    """(J,) radians or metres."""
    T_camera_base: np.ndarray
    """(4, 4)."""
    seed: tuple[int, ...]
    """What the view was drawn with: a ``ViewSeed`` in ``standard_views``."""
    mask: np.ndarray | None = None
    """(H, W) bool, what is given out as the object, rightly or not; None: all that is measured."""

    @property
    def object(self) -> str:
        """Name of the object."""
        return self.truth.name

    def observation(self) -> Observation:
        """What an estimator is shown. Raises InputError where noise or occlusion left too little of the object."""
        return Observation.from_depth(self.depth, self.camera, self.mask)

    def observed(self) -> Observation | None:
        """``observation``; None where too little of the object is left to be seen."""
        try:
            return self.observation()
        except InputError:
            return None


def true_pose(view: View, category: Category) -> ObjectPose:
    """Where the object of a view really is, in camera space."""
    placed = (view.truth.axes, view.truth.pivots, view.states, view.T_camera_base)
    tensors = (torch.as_tensor(values, dtype=torch.float64)[None] for values in placed)
    return ObjectPose.at(category.metric_tree, *tensors).rows()[0]


def observe_all(views: Iterable[View]) -> dict[int, Observation]:
    """What an estimator is shown of the views, by their index; those that show too little are left out."""
    found = enumerate(view.observed() for view in views)
    return {index: observation for index, observation in found if observation is not None}


@dataclass(frozen=True)
class Drawn:
    """A random view of an object, before any noise."""

    states: np.ndarray
    """(J,) radians or metres."""
    T_camera_base: np.ndarray
    """(4, 4)."""
    rendering: Rendering


def draw(
    model: ObjectModel, category: Category, generator: torch.Generator, camera: Camera = STANDARD_CAMERA,
    at_states: np.ndarray | None = None, views: ViewRange | None = None,
) -> Drawn:  # fmt: skip
    """``model`` at joint states ``at_states`` (J,), or random ones, seen from a random viewpoint of the category's
    ``views`` or others. Raises InputError for an object that is too thin or too small to be seen."""
    limits = torch.as_tensor(model.limits, dtype=torch.float64)[None]
    for _ in range(ATTEMPTS):
        states = at_states
        if states is None:
            states = sample_states(limits, generator)[0].numpy()
            keep_possible(states, model.limits, category.joints)
        centre, radius = bounding_sphere(np.concatenate(model.posed_vertices(states)))
        sphere = torch.as_tensor(centre)[None], torch.tensor([radius], dtype=torch.float64)
        T_camera_base = sample_poses(views or category.views, *sphere, generator, camera)[0].numpy()
        rendering = render(model, states, T_camera_base, camera)
        if np.count_nonzero(rendering.depth) >= MIN_PIXELS:
            return Drawn(states, T_camera_base, rendering)
    raise InputError(f"{model.name}: none of {ATTEMPTS} views shows {MIN_PIXELS} pixels of it; leave it out")


def standard_view(
    model: ObjectModel, category: Category, seed: Sequence[int], noise: NoiseLevel | None = None,
    states: np.ndarray | None = None,
) -> View:  # fmt: skip
    """A random view of ``model``, the same for the same ``seed`` (any non-negative integers), of random joint states or
    of ``states`` (J,). The noise changes the depth only: joint states and pose are those of the noise-free view of the
    same seed. Raises InputError for an object that is too thin or too small to be seen."""
    rng = np.random.default_rng(list(seed))
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    drawn = draw(model, category, generator, at_states=states)
    rendering = drawn.rendering
    depth = add_noise(rendering.depth, noise, STANDARD_CAMERA, rng, rendering.cos_view)
    labels = np.where(depth > 0, rendering.labels, np.uint8(NOTHING))
    return View(ObjectTruth.of(model), depth, labels, STANDARD_CAMERA, drawn.states, drawn.T_camera_base, tuple(seed))


def views_together(
    model: ObjectModel, category: Category, seed: Sequence[int], count: int, noise: NoiseLevel | None = None
) -> list[View]:
    """``model`` at one moment from ``count`` random viewpoints. All share a world frame, the object's base: a view's
    T_world_camera is the inverse of its T_camera_base."""
    views = [standard_view(model, category, (*seed, 0), noise)]
    for number in range(1, count):
        views.append(standard_view(model, category, (*seed, number), noise, views[0].states))
    return views


def view_seed(index: int, objects: int, seed: int) -> ViewSeed:
    """Seed of view ``index``: views are dealt out to the objects in turn, so view i is the same however many follow."""
    return seed, index % objects, index // objects


def standard_views(
    models: Sequence[ObjectModel],
    category: Category,
    views: int,
    seed: int = 0,
    noise: NoiseLevel | None = None,
    skip: int = 0,
) -> Iterator[View]:
    """``views`` in total, dealt out to the models in turn, without the first ``skip`` of them."""
    for index in range(skip, views):
        drawn = view_seed(index, len(models), seed)
        yield standard_view(models[drawn[1]], category, drawn, noise)
