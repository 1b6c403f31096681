"""Rerun recordings: what the camera saw and what was estimated, for the Rerun viewer."""

from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.files import write_atomic
from omad.estimation.estimate import Estimate
from omad.geometry.rigid import carry
from omad.sensing.observation import Observation

from .picture import part_colours
from .ply import byte_colours, part_surfaces

AXIS_LENGTH = 0.3
"""Of the object's size, on either side of the pivot."""


def save_rrd(estimate: Estimate, path: str | Path, observation: Observation) -> None:
    """Write ``path`` (.rrd): depth image and cloud, keypoints, part meshes, joint axes, and joint states as scalars.
    The world of the recording is the camera frame. Raises InputError where Rerun is not installed."""
    try:
        rr: Any = import_module("rerun")
    except ImportError as error:
        raise InputError("format rrd needs Rerun, which is not installed; pip install 'omad[rerun]'") from error
    write_atomic(path, lambda temporary: _record(rr, temporary, estimate, observation))


def _record(rr: Any, path: Path, estimate: Estimate, observation: Observation) -> None:
    recording = rr.RecordingStream("omad")
    recording.save(path)
    log = partial(recording.log, static=True)
    log("camera", rr.ViewCoordinates.RDF)
    camera = observation.camera
    if camera is not None and observation.depth is not None:
        log("camera/image", rr.Pinhole(image_from_camera=camera.K, resolution=[camera.width, camera.height]))
        log("camera/image/depth", rr.DepthImage(observation.depth, meter=1.0))
    colours, part_of = byte_colours(estimate), np.array(estimate.category.part_of_keypoint)
    seen = np.rint(255 * part_colours(estimate.part_labels)).astype(np.uint8)
    log("camera/cloud", rr.Points3D(observation.points, colors=seen, radii=0.001))
    log("camera/keypoints", rr.Points3D(estimate.keypoints, colors=colours[part_of], radii=0.003))
    surfaces = part_surfaces(estimate, observation)
    for spec, mesh, T, colour in zip(estimate.category.parts, surfaces, estimate.T_camera_part, colours, strict=True):
        placed = {"vertex_positions": carry(T, mesh.vertices), "triangle_indices": mesh.faces}
        log(f"camera/parts/{spec.name}", rr.Mesh3D(**placed, vertex_colors=np.tile(colour, (len(mesh.vertices), 1))))
    length = AXIS_LENGTH * np.linalg.norm(np.ptp(estimate.keypoints, axis=0))
    for index, joint in enumerate(estimate.joints):
        # a slide runs nowhere in particular: its arrow starts in the middle of its part
        middle = estimate.keypoints[part_of == index + 1].mean(0)
        origin = middle if joint.pivot is None else joint.pivot - length * joint.axis
        arrow = rr.Arrows3D(origins=[origin], vectors=[2 * length * joint.axis], labels=[joint.name])
        log(f"camera/axes/{joint.name}", arrow)
        recording.log(f"joints/{joint.name}", rr.Scalars(joint.state))
    recording.flush()
    recording.disconnect()
