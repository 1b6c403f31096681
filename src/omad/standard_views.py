"""Standard views: rendered depth images of object models from random viewpoints, with their truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from .camera import STANDARD_CAMERA, Camera
from .categories import Category
from .depth_noise import NoiseLevel, add_noise
from .objects import ObjectModel
from .render import NOTHING, render
from .viewpoints import sample_poses, sample_states

MIN_PIXELS = 500
"""A view that shows fewer pixels of the object is drawn again."""
ATTEMPTS = 1000


@dataclass(frozen=True)
class View:
    """One depth image of an object model, and the truth behind it."""

    model: ObjectModel
    depth: np.ndarray
    """(H, W) float32 metres, 0 where there is no measurement."""
    labels: np.ndarray
    """(H, W) uint8 part index, ``render.NOTHING`` where there is no measurement of the object."""
    camera: Camera
    states: np.ndarray
    """(J,) radians or metres."""
    T_camera_base: np.ndarray
    """(4, 4)."""


def standard_view(model: ObjectModel, category: Category, seed: Sequence[int], noise: NoiseLevel | None = None) -> View:
    """A random view of ``model``, the same for the same ``seed`` (any integers)."""
    rng = np.random.default_rng(list(seed))
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    limits = torch.as_tensor(model.limits, dtype=torch.float64)[None]
    for _ in range(ATTEMPTS):
        states = sample_states(limits, generator)[0].numpy()
        vertices = np.concatenate(model.posed_vertices(states))
        centre = (vertices.min(0) + vertices.max(0)) / 2
        radius = np.linalg.norm(vertices - centre, axis=1).max()
        pose = sample_poses(category.views, torch.as_tensor(centre)[None], torch.as_tensor([radius]), generator)
        T_camera_base = pose[0].numpy()
        rendering = render(model, states, T_camera_base, STANDARD_CAMERA)
        if (rendering.labels != NOTHING).sum() >= MIN_PIXELS:
            break
    else:
        raise RuntimeError(f"{model.name}: no view shows {MIN_PIXELS} pixels of it in {ATTEMPTS} attempts")
    depth = rendering.depth
    if noise is not None:
        depth = add_noise(depth, noise, STANDARD_CAMERA, rng, rendering.cos_view)
    labels = np.where(depth > 0, rendering.labels, NOTHING).astype(np.uint8)
    return View(model, depth, labels, STANDARD_CAMERA, states, T_camera_base)


def standard_views(
    models: Sequence[ObjectModel], category: Category, views: int, seed: int = 0, noise: NoiseLevel | None = None
) -> Iterator[View]:
    """``views`` in total, dealt out to the models in turn; view i is the same however many are drawn."""
    for index in range(views):
        yield standard_view(models[index % len(models)], category, (seed, index), noise)
