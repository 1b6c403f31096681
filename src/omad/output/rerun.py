"""Rerun recordings: what the camera saw and what was estimated, for the Rerun viewer."""

from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.files import write_atomic
from omad.estimation.estimate import Estimate
from omad.geometry.rigid import carry, diagonal
from omad.sensing.observation import Observation

from .frame import CAMERA, Frame
from .picture import part_colours
from .ply import byte_colours, part_surfaces

AXIS_LENGTH = 0.3
"""Of the object's size, on either side of the pivot."""


def save_rrd(estimate: Estimate, path: str | Path, observation: Observation, frame: Frame = CAMERA) -> None:
    """Write ``path`` (.rrd): depth and colour image, cloud, keypoints, part meshes, joint axes, and joint states as
    scalars. The world of the recording is ``frame``. Raises InputError where Rerun is not installed."""
    rr = imported()

    def record(temporary: Path) -> None:
        stream = rr.RecordingStream("omad")
        stream.save(temporary)
        log_frame(rr, stream, observation, estimate, static=True, frame=frame)
        finish(stream)

    write_atomic(path, record)


def imported() -> Any:
    """Rerun's package. Raises InputError where it is not installed."""
    try:
        return import_module("rerun")
    except ImportError as error:
        raise InputError("Rerun is not installed; pip install 'omad[rerun]'") from error


def finish(stream: Any) -> None:
    """Write what waits to be written, and end the recording."""
    stream.flush()
    stream.disconnect()


def log_frame(
    rr: Any,
    stream: Any,
    observation: Observation | None,
    estimate: Estimate | None,
    static: bool,
    frame: Frame = CAMERA,
) -> None:
    """What one frame shows, at the stream's time; or for all times where it is ``static``, with surfaces that are
    fitted to it. The world of the recording is ``frame``."""
    log = partial(stream.log, static=static)
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP if frame.upright else rr.ViewCoordinates.RDF, static=True)
    T = frame.T_frame_camera
    stream.log("camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]), static=True)
    camera = None if observation is None else observation.camera
    if observation is not None and camera is not None and observation.depth is not None:
        log("camera/image", rr.Pinhole(image_from_camera=camera.K, resolution=[camera.width, camera.height]))
        log("camera/image/depth", rr.DepthImage(observation.depth, meter=1.0))
        if observation.color is not None:
            log("camera/image/color", rr.Image(observation.color))
    labelled = observation is not None and estimate is not None and len(estimate.part_labels) == len(observation.points)
    there = {"image": observation is not None, "cloud": labelled}
    there |= dict.fromkeys(("keypoints", "parts", "axes"), estimate is not None)
    for entity in [] if static else [name for name, shown in there.items() if not shown]:
        log(f"camera/{entity}", rr.Clear(recursive=True))  # which would stay as it was
    if estimate is None:
        return
    colours, part_of = byte_colours(estimate), np.array(estimate.category.part_of_keypoint)
    if observation is not None and labelled:
        seen = np.rint(255 * part_colours(estimate.part_labels)).astype(np.uint8)
        log("camera/cloud", rr.Points3D(observation.points, colors=seen, radii=0.001))
    log("camera/keypoints", rr.Points3D(estimate.keypoints, colors=colours[part_of], radii=0.003))
    surfaces = part_surfaces(estimate, observation) if static else estimate.hulls
    for spec, mesh, T, colour in zip(estimate.category.parts, surfaces, estimate.T_camera_part, colours, strict=True):
        shape = {"vertex_positions": carry(T, mesh.vertices), "triangle_indices": mesh.faces}
        shown = rr.Mesh3D(**shape, vertex_colors=np.tile(colour, (len(mesh.vertices), 1)))
        log(f"camera/parts/{spec.name}", shown)
    length = AXIS_LENGTH * diagonal(estimate.keypoints)
    for index, joint in enumerate(estimate.joints):
        # a slide runs nowhere in particular: its arrow starts in the middle of its part
        middle = estimate.keypoints[part_of == index + 1].mean(0)
        origin = middle if joint.pivot is None else joint.pivot - length * joint.axis
        arrow = rr.Arrows3D(origins=[origin], vectors=[2 * length * joint.axis], labels=[joint.name])
        log(f"camera/axes/{joint.name}", arrow)
        stream.log(f"joints/{joint.name}", rr.Scalars(joint.state))
