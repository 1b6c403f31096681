"""Pictures of a track: joint states over time, and a film of what was seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from ..camera import Camera
from ..categories import Category
from ..observation import Observation
from ..report import PART_COLOURS
from .tracker import TrackedEstimate

UNSEEN = {"lost": "0.82", "coasting": "0.93"}
"""Shades of grey behind the frames that were not used."""
WIDTH = 320
"""Pixels of a film's frames."""


def states_over_time(
    category: Category, tracked: Sequence[TrackedEstimate], truth: Sequence[list[float] | None] | None = None
) -> Figure:
    """A panel a joint, in degrees or centimetres: the smoothed state with one standard deviation, each frame's own
    answer, and the truth (a list a frame, None where it is not known)."""
    joints = category.joints
    fig = Figure(figsize=(10, 1.2 + 2.6 * len(joints)), facecolor="white", layout="constrained")
    panels = fig.subplots(len(joints), 1, sharex=True, squeeze=False)[:, 0]
    times = np.array([each.time for each in tracked])
    for j, (panel, joint) in enumerate(zip(panels, joints, strict=True)):
        turns = joint.type == "revolute"
        factor = np.degrees(1) if turns else 100.0
        found = [None if each.estimate is None else each.estimate.joints[j] for each in tracked]
        state = factor * np.array([np.nan if one is None else one.state for one in found])
        std = factor * np.array([np.nan if one is None else one.state_std for one in found])
        single = factor * np.array([np.nan if each.single is None else each.single.joints[j].state for each in tracked])
        _shade_unseen(panel, tracked, times)
        panel.plot(times, single, ".", color="0.45", markersize=3.5, label="each frame alone")
        panel.fill_between(times, state - std, state + std, color="tab:blue", alpha=0.25, linewidth=0)
        panel.plot(times, state, color="tab:blue", linewidth=1.6, label="tracked, ± 1 standard deviation")
        if truth is not None:
            true = [np.nan if states is None else factor * states[j] for states in truth]
            panel.plot(times, true, "--", color="black", linewidth=1.1, label="truth")
        panel.set_ylabel(f"{joint.name} ({'°' if turns else 'cm'})")
        panel.grid(alpha=0.3)
        panel.margins(x=0.01)
    panels[-1].set_xlabel("seconds")
    fig.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    return fig


def _shade_unseen(panel: Axes, tracked: Sequence[TrackedEstimate], times: np.ndarray) -> None:
    ends = np.append(times[1:], times[-1:])
    statuses = [each.status for each in tracked]
    for status, shade in UNSEEN.items():
        label = {"lost": "lost", "coasting": "predicted"}[status]
        for index in (i for i, s in enumerate(statuses) if s == status):
            panel.axvspan(times[index], ends[index], color=shade, linewidth=0, label=label)
            label = "_"


class Film:
    """Small pictures of frames with what was tracked in them, for an animated GIF."""

    def __init__(self) -> None:
        self.pictures: list[Image.Image] = []

    def add(self, observation: Observation | None, tracked: TrackedEstimate) -> None:
        """A frame's depth with keypoints and joint axes; frames without an image repeat the last background."""
        if observation is None or observation.depth is None or observation.camera is None:
            if self.pictures:
                blank = Image.new("RGB", self.pictures[-1].size, (40, 40, 40))
                ImageDraw.Draw(blank).text((6, 4), tracked.status, fill="white")
                self.pictures.append(blank)
            return
        camera, scale = observation.camera, WIDTH / observation.camera.width
        near, far = np.percentile(observation.points[:, 2], [1, 99])
        grey = np.where(observation.depth > 0, 1 - (observation.depth - near) / (far - near + 1e-6) * 0.7, 0)
        image = Image.fromarray((255 * np.clip(grey, 0, 1)).astype(np.uint8))
        image = image.resize((WIDTH, round(scale * camera.height))).convert("RGB")
        draw = ImageDraw.Draw(image)
        draw.text((6, 4), f"{tracked.time:.1f} s  {tracked.status}", fill="white")
        if tracked.estimate is not None:
            _draw_estimate(draw, camera, scale, tracked)
        self.pictures.append(image)

    def save(self, path, seconds: float) -> None:
        """Write the GIF; it takes ``seconds``."""
        colours = [picture.quantize(64) for picture in self.pictures]
        each = round(1000 * seconds / len(colours))
        colours[0].save(path, save_all=True, append_images=colours[1:], duration=max(each, 20), loop=0)


def _draw_estimate(draw: ImageDraw.ImageDraw, camera: Camera, scale: float, tracked: TrackedEstimate) -> None:
    estimate = tracked.estimate
    assert estimate is not None

    def at(points: np.ndarray) -> list[tuple[float, float]]:
        z = np.maximum(points[:, 2], 1e-6)
        u, v = camera.fx * points[:, 0] / z + camera.cx, camera.fy * points[:, 1] / z + camera.cy
        return [(float(x), float(y)) for x, y in zip(scale * u, scale * v, strict=True)]

    centre = estimate.keypoints.mean(0)
    for joint in estimate.joints:
        half = 0.6 * np.ptp((estimate.keypoints - centre) @ joint.axis)
        foot = centre if joint.pivot is None else joint.pivot + joint.axis * (joint.axis @ (centre - joint.pivot))
        draw.line(at(np.stack([foot - half * joint.axis, foot + half * joint.axis])), fill=(220, 20, 60), width=2)
    for (u, v), part in zip(at(estimate.keypoints), estimate.category.part_of_keypoint, strict=True):
        red, green, blue = (255 * PART_COLOURS[part % len(PART_COLOURS)]).astype(int)
        draw.ellipse((u - 3, v - 3, u + 3, v + 3), fill=(red, green, blue), outline="black")
