"""Surfaces of the estimated parts, and the PLY files that hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from ..estimate import Estimate, convex_hull
from ..files import write_atomic
from ..objects import Mesh
from ..observation import Observation
from ..report import PART_COLOURS

MARGIN = 0.1
"""Of a part's size: points farther from the box of its keypoints are taken for another part's."""


def part_surfaces(estimate: Estimate, observation: Observation | None = None) -> list[Mesh]:
    """A mesh for each part, canonical rest coordinates, metres: the hull of its keypoints, and of the points that were
    seen of it where ``observation`` is given."""
    part_of = np.array(estimate.category.part_of_keypoint)
    meshes = []
    for part, T_camera_part in enumerate(estimate.T_camera_part):
        points = estimate.canonical_keypoints[part_of == part]
        if observation is not None:
            seen = observation.points[estimate.part_labels == part].astype(np.float64)
            seen = (seen - T_camera_part[:3, 3]) @ T_camera_part[:3, :3]
            low, high = points.min(0), points.max(0)
            margin = MARGIN * np.linalg.norm(high - low)
            inside = ((seen > low - margin) & (seen < high + margin)).all(1)
            points = np.concatenate([points, seen[inside]])
        meshes.append(convex_hull(points))
    return meshes


def part_colours(estimate: Estimate) -> np.ndarray:
    """(K, 3) uint8, the colours of the parts in every picture."""
    count = len(estimate.category.parts)
    return np.rint(255 * PART_COLOURS[np.arange(count) % len(PART_COLOURS)]).astype(np.uint8)


def save_ply(estimate: Estimate, folder: str | Path, observation: Observation | None = None) -> list[Path]:
    """Write ``object.ply`` (all parts, coloured) and ``part-<name>.ply`` each: camera frame, metres, estimated state,
    so that they lie on the observed cloud. Returns the files."""
    folder, files = Path(folder), []
    posed = []
    surfaces = part_surfaces(estimate, observation)
    for mesh, T, colour in zip(surfaces, estimate.T_camera_part, part_colours(estimate), strict=True):
        vertices = mesh.vertices @ T[:3, :3].T + T[:3, 3]
        colours = np.tile(np.append(colour, 255).astype(np.uint8), (len(vertices), 1))
        posed.append(trimesh.Trimesh(vertices, mesh.faces, vertex_colors=colours, process=False))
    named = {f"part-{part.name}": mesh for part, mesh in zip(estimate.category.parts, posed, strict=True)}
    for name, mesh in {"object": trimesh.util.concatenate(posed), **named}.items():
        content = mesh.export(file_type="ply")
        write_atomic(folder / f"{name}.ply", lambda path, content=content: path.write_bytes(content))
        files.append(folder / f"{name}.ply")
    return files
