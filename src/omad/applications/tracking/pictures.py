"""Pictures of a track: joint states over time, and a film of what was seen."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from omad.data.rendering.rasteriser import NOTHING, render
from omad.estimation.estimate import Estimate
from omad.geometry.camera import Camera
from omad.objects.category import Category
from omad.output.frame_image import frame_image
from omad.output.picture import axis_segments, reading, shaded
from omad.sensing.observation import Observation

from .tracker import TrackedEstimate, TrackedStates

UNSEEN = {"lost": ("0.82", "lost"), "coasting": ("0.93", "predicted")}
"""Shades of grey behind the frames that were not used, and what they are called."""
WIDTH = 480
"""Pixels of a film's frames."""
MOST = 600
"""Frames of a film at most: of longer tracks it has every second one, or fourth ..."""
SOLID = 170
"""Of 255: how much of a pixel is the drawn surface's."""
Truth = Sequence[list[float] | None]
"""True joint states of each frame; None where they are not known."""


def states_over_time(category: Category, tracked: Sequence[TrackedStates], truth: Truth | None = None) -> Figure:
    """A panel a joint, in degrees or centimetres: the smoothed state with one standard deviation, each frame's own
    answer, and the truth."""
    joints = category.joints
    fig = Figure(figsize=(10, 1.2 + 2.6 * len(joints)), facecolor="white", layout="constrained")
    panels = fig.subplots(len(joints), 1, sharex=True, squeeze=False)[:, 0]
    times, told = np.array([each.time for each in tracked]), np.array([each.told for each in tracked])
    for j, (panel, joint) in enumerate(zip(panels, joints, strict=True)):
        per_unit, unit = reading(joint.motion.turns)
        state, std, single = told[:, :, j].T / per_unit
        _shade_unseen(panel, tracked, times)
        panel.plot(times, single, ".", color="0.45", markersize=3.5, label="each frame alone")
        panel.fill_between(times, state - std, state + std, color="tab:blue", alpha=0.25, linewidth=0)
        panel.plot(times, state, color="tab:blue", linewidth=1.6, label="tracked, ± 1 standard deviation")
        if truth is not None:
            true = [np.nan if states is None else states[j] / per_unit for states in truth]
            panel.plot(times, true, "--", color="black", linewidth=1.1, label="truth")
        panel.set(ylabel=f"{joint.name} ({unit.strip()})", xmargin=0.01)
        panel.grid(alpha=0.3)
    panels[-1].set_xlabel("seconds")
    fig.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    return fig


def _shade_unseen(panel: Axes, tracked: Sequence[TrackedStates], times: np.ndarray) -> None:
    ends = np.append(times[1:], times[-1:])
    for status, (shade, label) in UNSEEN.items():
        for each, end in zip(tracked, ends, strict=True):
            if each.status == status:
                panel.axvspan(each.time, end, color=shade, linewidth=0, label=label)
                label = "_"  # the legend names it once


class Film:
    """Small pictures of frames with what was tracked in them, for an animated GIF."""

    def __init__(self) -> None:
        self.pictures: list[Image.Image] = []
        self._every, self._frames = 1, 0

    def add(self, observation: Observation | None, tracked: TrackedEstimate) -> None:
        """A frame's colours, or its depth, with the object's surface and axes; a frame without an image is dark."""
        if self._frames % self._every == 0 and (picture := self._picture(observation, tracked)) is not None:
            self.pictures.append(picture)
        self._frames += bool(self.pictures)
        if len(self.pictures) > MOST:
            self._every *= 2
            self.pictures = self.pictures[::2]

    def _picture(self, observation: Observation | None, tracked: TrackedEstimate) -> Image.Image | None:
        """None before the first image."""
        if observation is None or observation.depth is None or observation.camera is None:
            if not self.pictures:
                return None
            blank = Image.new("RGB", self.pictures[-1].size, (40, 40, 40))
            ImageDraw.Draw(blank).text((6, 4), tracked.status, fill="white")
            return blank
        scale = WIDTH / observation.camera.width
        corner = 0.5 / scale - 0.5  # pixel centres are at integers
        size = WIDTH, max(round(scale * observation.camera.height), 1)
        image = Image.fromarray(frame_image(observation)).resize(size)
        camera = observation.camera.zoomed(scale, corner, corner, image.size)
        if tracked.estimate is not None:
            image = _with_surface(image, camera, tracked.estimate)
        draw = ImageDraw.Draw(image)
        draw.text((6, 4), f"{tracked.time:.1f} s  {tracked.status}", fill="black", stroke_width=2, stroke_fill="white")
        if tracked.estimate is not None:
            _draw_axes(draw, camera, tracked.estimate)
        return image

    def save(self, path: Path, seconds: float) -> None:
        """Write the GIF; it takes ``seconds``."""
        first, *others = (picture.quantize(128) for picture in self.pictures)
        each = max(round(1000 * seconds / len(self.pictures)), 20)
        first.save(path, save_all=True, append_images=others, duration=each, loop=0)


def _with_surface(image: Image.Image, camera: Camera, estimate: Estimate) -> Image.Image:
    """The object's parts over what was seen of them."""
    seen = render(estimate.carried_model(), estimate.joint_states, estimate.T_camera_base, camera)
    there = Image.fromarray(np.where(seen.labels != NOTHING, SOLID, 0).astype(np.uint8))
    return Image.composite(Image.fromarray((255 * shaded(seen)).astype(np.uint8)), image, there)


def _draw_axes(draw: ImageDraw.ImageDraw, camera: Camera, estimate: Estimate) -> None:
    for ends in axis_segments(estimate.category, estimate.placed, estimate.keypoints):
        draw.line(camera.project(ends).ravel().tolist(), fill=(220, 20, 60), width=2)
