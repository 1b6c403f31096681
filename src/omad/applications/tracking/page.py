"""One self-contained HTML page a track: a slider for time, what the camera saw at each frame, and the object beside it.
``page.html`` beside this file is the page; this module fills in its one JSON object."""

from pathlib import Path
from typing import Any

import matplotlib.colors
import numpy as np
from PIL import Image

from omad.common.files import write_text
from omad.estimation.estimate import Estimate, plain
from omad.geometry.camera import Camera
from omad.geometry.rigid import carry
from omad.output.frame_image import frame_image, jpeg_uri
from omad.output.page import filled
from omad.output.picture import axis_segments, part_colours
from omad.sensing.observation import Observation

from .tracker import TrackedEstimate

WIDTH = 480
"""Pixels of a frame's picture at most."""
MOST_SHOWN = 600
"""Frames of a page with picture and cloud at most: of longer tracks every second has them, or fourth ..."""
MAX_POINTS = 500
"""Of a frame's cloud that are drawn."""


class TrackPage:
    """Collects frames, and writes the page."""

    def __init__(self) -> None:
        self._frames: list[dict[str, Any]] = []
        self._every = 1
        self._last: Estimate | None = None

    def add(self, name: str, observation: Observation | None, tracked: TrackedEstimate) -> None:
        """The next frame; None where it shows nothing."""
        estimate = tracked.estimate
        frame: dict[str, Any] = {"name": name, "time": round(tracked.time, 4), "status": tracked.status}
        if estimate is not None:
            self._last = estimate
            inverse = np.linalg.inv(estimate.T_camera_base)
            frame["parts"] = np.round(inverse @ estimate.T_camera_part, 5)[:, :3]
            frame["states"] = [[joint.state, joint.state_std] for joint in estimate.joints]
        if observation is not None and len(self._frames) % self._every == 0:
            frame |= self._seen(observation, estimate)
        self._frames.append(plain(frame))
        if len(self._frames) > MOST_SHOWN * self._every:
            self._every *= 2
            for index, each in enumerate(self._frames):
                if index % self._every:
                    for key in ("picture", "cloud"):
                        each.pop(key, None)

    def _seen(self, observation: Observation, estimate: Estimate | None) -> dict[str, Any]:
        """The cloud; of a frame with an image its picture, too, and where in it keypoints and joint axes are."""
        shown = {} if observation.camera is None else self._picture(observation, observation.camera, estimate)
        if estimate is not None:
            step = -(-len(observation.points) // MAX_POINTS)
            cloud = carry(np.linalg.inv(estimate.T_camera_base), observation.points[::step])
            shown["cloud"] = np.round(cloud, 4)
        return shown

    def _picture(self, observation: Observation, camera: Camera, estimate: Estimate | None) -> dict[str, Any]:
        factor = min(1.0, WIDTH / camera.width)
        size = round(factor * camera.width), max(round(factor * camera.height), 1)
        picture = jpeg_uri(Image.fromarray(frame_image(observation)).resize(size))
        if estimate is None:
            return {"picture": picture, "size": size}
        small = camera.zoomed(factor, -0.5, -0.5)  # a canvas counts from the pixel's corner
        axes = axis_segments(estimate.category, estimate.placed, estimate.keypoints)
        dots = small.project(estimate.keypoints)
        lines = [small.project(ends).ravel() for ends in axes]
        return {"picture": picture, "size": size, "dots": np.round(dots, 1), "axes": np.round(lines, 1)}

    def save(self, path: Path, title: str) -> None:
        """Write the page; nothing where the object was never seen."""
        if (estimate := self._last) is None:
            return
        parts, part_of = estimate.object_model().parts, estimate.category.part_of_keypoint
        record = {
            "title": title,
            "parts": [
                {"name": spec.name, "colour": matplotlib.colors.to_hex(tuple(part_colours(k)))}
                | {"vertices": np.round(mesh.vertices, 5), "faces": mesh.faces}
                for k, (spec, mesh) in enumerate(zip(estimate.category.parts, parts, strict=True))
            ],
            "joints": [{"name": joint.name, "turns": joint.pivot is not None} for joint in estimate.joints],
            "part_of": part_of,
            "frames": self._frames,
        }
        write_text(path, filled("omad.applications.tracking", plain(record)))
