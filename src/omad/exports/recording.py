"""Rerun recordings: what the camera saw and what was estimated, for the Rerun viewer."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..estimate import Estimate
from ..files import write_atomic
from ..observation import Observation
from .surfaces import part_colours, part_surfaces

AXIS_LENGTH = 0.3
"""Of the object's size, on either side of the pivot."""


def save_rrd(estimate: Estimate, path: str | Path, observation: Observation) -> None:
    """Write ``path`` (.rrd): depth image and cloud, keypoints, part meshes, joint axes, and joint states as scalars.

    The world of the recording is the camera frame. Raises InputError where Rerun is not installed.
    """
    try:
        rr: Any = import_module("rerun")
    except ImportError as error:
        raise InputError("format rrd needs Rerun, which is not installed; pip install 'omad[rerun]'") from error
    write_atomic(path, lambda temporary: _record(rr, temporary, estimate, observation))


def _record(rr: Any, path: Path, estimate: Estimate, observation: Observation) -> None:
    recording = rr.RecordingStream("omad")
    recording.save(path)
    recording.log("camera", rr.ViewCoordinates.RDF, static=True)
    camera = observation.camera
    if camera is not None and observation.depth is not None:
        pinhole = rr.Pinhole(image_from_camera=camera.K, resolution=[camera.width, camera.height])
        recording.log("camera/image", pinhole, static=True)
        recording.log("camera/image/depth", rr.DepthImage(observation.depth, meter=1.0), static=True)
    colours = part_colours(estimate)
    cloud = rr.Points3D(observation.points, colors=colours[estimate.part_labels], radii=0.001)
    recording.log("camera/cloud", cloud, static=True)
    part_of = np.array(estimate.category.part_of_keypoint)
    keypoints = rr.Points3D(estimate.keypoints, colors=colours[part_of], radii=0.003)
    recording.log("camera/keypoints", keypoints, static=True)
    surfaces = part_surfaces(estimate, observation)
    for spec, mesh, T, colour in zip(estimate.category.parts, surfaces, estimate.T_camera_part, colours, strict=True):
        vertices = mesh.vertices @ T[:3, :3].T + T[:3, 3]
        colour = np.tile(colour, (len(vertices), 1))
        shape = rr.Mesh3D(vertex_positions=vertices, triangle_indices=mesh.faces, vertex_colors=colour)
        recording.log(f"camera/parts/{spec.name}", shape, static=True)
    length = AXIS_LENGTH * np.linalg.norm(np.ptp(estimate.keypoints, axis=0))
    for index, joint in enumerate(estimate.joints):
        # a slide runs nowhere in particular: its arrow starts in the middle of its part
        middle = estimate.keypoints[part_of == index + 1].mean(0)
        origin = middle if joint.pivot is None else joint.pivot - length * joint.axis
        arrow = rr.Arrows3D(origins=[origin], vectors=[2 * length * joint.axis], labels=[joint.name])
        recording.log(f"camera/axes/{joint.name}", arrow, static=True)
        recording.log(f"joints/{joint.name}", rr.Scalars(joint.state))
    recording.flush()
    recording.disconnect()
