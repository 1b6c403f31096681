"""Rendered sequences with truth: an object whose joints move to and fro before a moving camera."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from omad.data.rendering.depth_noise import ON, NoiseLevel, add_noise
from omad.data.rendering.rasteriser import render
from omad.data.rendering.viewpoints import SPAN, pose_before
from omad.geometry.camera import STANDARD_CAMERA
from omad.geometry.rigid import bounding_sphere
from omad.objects.category import Category
from omad.objects.model import ObjectModel


@dataclass(frozen=True)
class SequenceConfig:
    """What happens in a sequence."""

    frames: int = 150
    fps: float = 15.0
    period: float = 6.0
    """Seconds in which the first joint opens and closes; each further joint takes a fifth longer."""
    swing: float = 0.5
    """Share of the azimuth's and the elevation's range that the camera sweeps in 9 and 7 seconds; 0: it stands."""
    gap: tuple[int, int] | None = None
    """First frame without the object, and the first with it again."""
    noise: NoiseLevel | None = ON
    seed: int = 0
    """Of camera noise and of where the camera starts."""


@dataclass(frozen=True)
class SequenceFrame:
    """One frame and its truth."""

    time: float
    depth: np.ndarray
    """(H, W) float32 metres."""
    states: np.ndarray
    """(J,) radians or metres."""
    T_camera_base: np.ndarray
    """(4, 4)."""


def render_sequence(
    model: ObjectModel, category: Category, config: SequenceConfig | None = None
) -> Iterator[SequenceFrame]:
    """Frames of the standard camera, from standard viewpoints; the same for the same arguments."""
    config = config or SequenceConfig()
    rng = np.random.default_rng(config.seed)
    low, high = model.limits.T
    places = [vertices for states in (low, (low + high) / 2, high) for vertices in model.posed_vertices(states)]
    centre, radius = bounding_sphere(np.concatenate(places))
    camera, views = STANDARD_CAMERA, category.views
    distance = radius * np.hypot(1, 2 * camera.fy / (np.mean(SPAN) * camera.height))
    periods = config.period * 1.2 ** np.arange(len(low))
    phase = rng.uniform(0, 2 * np.pi, 2)
    bottom, top = views.elevation
    for index in range(config.frames):
        time = index / config.fps
        states = low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * time / periods))
        azimuth = views.azimuth * config.swing * np.sin(2 * np.pi * time / 9 * (config.swing > 0) + phase[0])
        raised = config.swing * np.sin(2 * np.pi * time / 7 * (config.swing > 0) + phase[1])
        elevation = min((bottom + top + (top - bottom) * raised) / 2, np.pi / 2 - 1e-3)
        pose = pose_before(distance, azimuth, elevation, centre)
        rendering = render(model, states, pose, camera)
        depth = add_noise(rendering.depth, config.noise, camera, rng, rendering.cos_view)
        if config.gap is not None and config.gap[0] <= index < config.gap[1]:
            depth = np.zeros_like(depth)
        yield SequenceFrame(time, depth, states, pose)
