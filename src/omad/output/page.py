"""One self-contained HTML page an estimate: it opens from disk, needs no network, and its sliders move the object.
``page.html`` beside this file is the page; this module fills in ``space.js``, with which all pages draw, and one JSON
object. Lengths are metres, angles radians, points in the camera frame unless they are called canonical."""

import base64
import io
import json
from dataclasses import asdict
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

import matplotlib.colors
import numpy as np
from PIL import Image

from omad.common.errors import InputError
from omad.common.files import write_text
from omad.estimation.estimate import Estimate
from omad.geometry.mesh import convex_hull
from omad.objects.pose import ObjectPose
from omad.sensing.observation import Observation

from .frame_image import frame_image, jpeg_uri
from .picture import camera_around, labels_of, part_colours, window

MAX_POINTS = 4000
"""Points of the cloud on a page at most: it stays under 200 kB."""
MAX_IMAGE = 480
"""Pixels along the longer side of the depth picture."""
DATA, SPACE = "__DATA__", "__SPACE__"
"""Where a template takes its JSON, and the drawing code that all pages share (``space.js``)."""


def save_html(
    observation: Observation, estimate: Estimate, path: str | Path, truth: ObjectPose | None = None, title: str = ""
) -> None:
    """Write the page. With ``truth`` its table shows true states beside the estimated ones."""
    write_text(path, page_text(observation, estimate, truth, title))


def page_text(observation: Observation, estimate: Estimate, truth: ObjectPose | None = None, title: str = "") -> str:
    """The page as text. ``title`` may be any text: it is never read as HTML."""
    return filled("omad.output", page_data(observation, estimate, truth, title))


def filled(package: str, data: Any) -> str:
    """The template ``page.html`` of a package, with the drawing code and with ``data`` (plain JSON values) in it."""
    template, code = (
        package_files(owner).joinpath(name).read_text(encoding="utf-8")
        for owner, name in ((package, "page.html"), ("omad.output", "space.js"))
    )
    text = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return template.replace(SPACE, code, 1).replace(DATA, text, 1)  # a "</script>" in a name must not end the script


def page_data(
    observation: Observation, estimate: Estimate, truth: ObjectPose | None = None, title: str = ""
) -> dict[str, Any]:
    """All that a page shows, as plain JSON values; what is not finite is null."""
    if isinstance(observation, Estimate):
        raise InputError("save_html: was given the estimate first; give the observation, then the estimate")
    category, model = estimate.category, estimate.object_model()
    # at random: every n-th would draw stripes
    drawn = np.sort(np.random.default_rng(0).permutation(len(observation.points))[:MAX_POINTS])
    part_of, initial = np.array(category.part_of_keypoint), estimate.initial
    parts = [
        {"name": name, "colour": matplotlib.colors.to_hex(tuple(part_colours(k)))}
        | {"canonical_vertices": _rounded(mesh.vertices, 5), "faces": mesh.faces.tolist()}
        | {"initial_vertices": _rounded(before.vertices, 5), "initial_faces": before.faces.tolist()}
        for k, (name, mesh) in enumerate(zip(model.part_names, model.parts, strict=True))
        for before in [convex_hull(initial.keypoints[part_of == k])]
    ]
    joints = [
        {"name": joint.name, "type": joint.type, **asdict(joint.unit_motion), "fraction": _rounded(joint.fraction, 4)}
        | {"state": _rounded(joint.state, 9), "state_std": _rounded(joint.state_std, 6)}
        | {"limits": _rounded(joint.limits, 6), "axis": _rounded(joint.axis, 6), "pivot": _rounded(joint.pivot, 5)}
        | {"initial_state": _rounded(before.state, 6), "initial_axis": _rounded(before.axis, 6)}
        | {"initial_pivot": _rounded(before.pivot, 5), "parent": category.tree.parents[j]}
        | {"at_most": category.joints[j].at_most}
        | {"canonical_axis": _rounded(estimate.canonical_axes[j], 9)}
        | {"canonical_pivot": _rounded(estimate.canonical_pivots[j], 7)}
        | {"true_state": None if truth is None else _rounded(truth.states[j], 6)}
        for j, (joint, before) in enumerate(zip(estimate.joints, initial.joints, strict=True))
    ]
    return {
        "title": title or category.name,
        "category": category.name,
        "converged": estimate.converged,
        "probability": _rounded(estimate.probability, 4),
        "doubtful": estimate.doubtful,
        "residual": _rounded(estimate.residual, 6),
        "warnings": list(estimate.warnings),
        "seconds": {name: _rounded(value, 4) for name, value in estimate.seconds.items()},
        "picture": _picture(observation) | {"colours": observation.color is not None},
        "cloud": _rounded(observation.points[drawn], 4),
        "labels": labels_of(estimate, observation)[drawn].tolist(),
        "points": len(observation.points),
        "parts": parts,
        "part_of_keypoint": part_of.tolist(),
        "canonical_keypoints": _rounded(estimate.canonical_keypoints, 7),
        "T_camera_base": _rounded(estimate.T_camera_base, 9),
        "seen_keypoints": _rounded(estimate.observed_keypoints, 5),
        "keypoint_std": _rounded(estimate.keypoint_std, 5),
        "initial_keypoints": _rounded(initial.keypoints, 5),
        "joints": joints,
    }


def _picture(observation: Observation) -> dict[str, Any]:
    """The depth image around the object and how points project into it; of a bare cloud only the latter."""
    camera = observation.camera or camera_around(observation.points)
    left, right, top, bottom = window(camera, observation.points)
    x1, y1, x2, y2 = map(int, (left, top, right + 1, bottom + 1))
    if observation.depth is not None:  # its picture ends at the image
        (x1, x2), (y1, y2) = np.clip((x1, x2), 0, camera.width), np.clip((y1, y2), 0, camera.height)
    scale = MAX_IMAGE / max(x2 - x1, y2 - y1)
    size = max(round((x2 - x1) * scale), 1), max(round((y2 - y1) * scale), 1)
    # pixel centres are at integers, a canvas counts from the pixel's corner
    canvas = camera.zoomed(scale, x1 - 0.5, y1 - 0.5, size)
    shown = {key: getattr(canvas, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
    return {**shown, "source": _source(observation, slice(y1, y2), slice(x1, x2))}


def _source(observation: Observation, rows: slice, columns: slice) -> str | None:
    """Colours or depth of a part of the image as a data URI; of a bare cloud None."""
    if observation.depth is None:
        return None
    image = Image.fromarray(frame_image(observation)[rows, columns])
    image.thumbnail((2 * MAX_IMAGE, 2 * MAX_IMAGE), Image.Resampling.NEAREST)
    if observation.color is not None:
        return jpeg_uri(image)
    stored = io.BytesIO()
    image.quantize(256, Image.Quantize.FASTOCTREE).save(stored, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(stored.getvalue()).decode()


def _rounded(values: Any, digits: int) -> Any:
    """Plain numbers with so many decimals; null where there is none, or it is not finite."""
    rounded = np.round(np.asarray(values, dtype=float), digits)
    plain = np.asarray(rounded, dtype=object)
    plain[~np.isfinite(rounded)] = None
    return plain.tolist()
