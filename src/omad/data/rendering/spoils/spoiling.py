"""Scenes made into views that are spoilt as asked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from omad.common.errors import InputError
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from ..depth_noise import LEVELS, add_noise
from ..rasteriser import NOTHING, Rendering
from ..sensor_noise import SENSORS, sense
from ..standard_views import MIN_PIXELS, View
from .depths import blotted, patched, wavy
from .masks import grown, shifted, with_rim, without_part
from .occluders import occluder
from .scenes import FIRST_OTHER, OBJECT, SpoilScene, draw_scene, in_front
from .spoil import Spoil, random_spoil

ATTEMPTS = 100


class _Step(IntEnum):
    """Each step has a stream of random numbers of its own: it does the same alone as together with others."""

    SPOIL = 9
    HIDE = 10
    NOISE = 11
    WAVES = 12
    PATCH = 13
    LOSE = 14
    SHIFT = 15
    MISS = 16


@dataclass(frozen=True)
class SpoiltView:
    """A view whose mask is what is given out as the object; what is the object, its ``labels`` say."""

    view: View
    instances: np.ndarray
    """(H, W) uint8: ``scenes.BACKGROUND``, ``OBJECT``, other things from ``FIRST_OTHER``; NOTHING where nothing is
    measured."""


def spoilt(scene: SpoilScene, spoil: Spoil) -> SpoiltView:
    """The scene's view, spoilt; the same for the same arguments. Joint states and pose are the scene's."""

    def rng(step: _Step) -> np.random.Generator:
        return np.random.default_rng([*scene.seed, step])

    exact, labels, instances, mask = _shown(scene, spoil, rng)
    depth, source = exact.depth, np.arange(exact.depth.size).reshape(exact.depth.shape)
    if spoil.noise in SENSORS:
        sensed = sense(depth, SENSORS[spoil.noise], exact.cos_view, rng(_Step.NOISE))
        depth, source = sensed.depth, sensed.source
    else:
        depth = add_noise(depth, LEVELS[spoil.noise], scene.camera, rng(_Step.NOISE), exact.cos_view)
    if spoil.part_missed:
        mask = without_part(mask, labels, rng(_Step.MISS))
    labels, instances = labels.ravel()[source], instances.ravel()[source]
    on = labels != NOTHING
    if spoil.waves > 0:
        depth = wavy(depth, spoil.waves * scene.truth.diagonal, rng(_Step.WAVES))
    depth = patched(depth, on, spoil.patch, rng(_Step.PATCH))
    depth = blotted(depth, on, spoil.lost, rng(_Step.LOSE))

    if spoil.shifted:
        mask = shifted(mask, spoil.shifted, rng(_Step.SHIFT))
    mask = grown(mask, spoil.grown)
    labels, instances = (np.where(depth > 0, image, np.uint8(NOTHING)) for image in (labels, instances))
    view = View(scene.truth, depth, labels, scene.camera, scene.states, scene.T_camera_base, scene.seed, mask)
    return SpoiltView(view, instances)


def within_range(scene: SpoilScene, spoil: Spoil) -> bool:
    """Whether the object is as far off as the spoil's camera works."""
    if spoil.noise not in SENSORS:
        return True
    nearest, farthest = SENSORS[spoil.noise].working
    return nearest <= scene.distance <= farthest


def cluttered(model: ObjectModel, category: Category, seed: Sequence[int]) -> tuple[Spoil, SpoiltView]:
    """A scene of ``model`` spoilt at random, and how; the same for the same ``seed`` (any non-negative integers).
    Raises InputError for an object of which no scene shows enough."""
    for attempt in range(ATTEMPTS):
        drawn = (*seed, attempt)
        spoil = random_spoil(np.random.default_rng([*drawn, _Step.SPOIL]))
        scene = draw_scene(model, category, drawn, spoil.staging)
        if not within_range(scene, spoil):
            continue
        made = spoilt(scene, spoil)
        if np.count_nonzero((made.view.labels != NOTHING) & made.view.mask) >= MIN_PIXELS:
            return spoil, made
    raise InputError(f"{model.name}: none of {ATTEMPTS} scenes shows {MIN_PIXELS} pixels of it; leave it out")


def _shown(
    scene: SpoilScene, spoil: Spoil, rng: Callable[[_Step], np.random.Generator]
) -> tuple[Rendering, np.ndarray, np.ndarray, np.ndarray]:
    """The exact image; of it part labels, instances, and the mask with what it takes in of an occluder."""
    exact = in_front(scene.thing, scene.around)
    mine = (scene.thing.depth > 0) & (exact.depth == scene.thing.depth)
    instances = np.where(mine, np.uint8(OBJECT), scene.around.labels)
    mask = mine if scene.mask is None else scene.mask
    if spoil.hidden > 0:
        front = occluder(mine, scene.thing.depth, scene.camera, spoil.hidden, rng(_Step.HIDE))
        exact, hides = in_front(front, exact), front.depth > 0
        hides &= exact.depth == front.depth
        others = instances[(instances != NOTHING) & (instances >= FIRST_OTHER)]
        instances = np.where(hides, np.uint8(others.max(initial=OBJECT) + 1), instances)
        mine = mine & ~hides
        mask = with_rim(mask & ~hides, hides, spoil.rim)
    return exact, np.where(mine, scene.thing.labels, np.uint8(NOTHING)), instances, mask
