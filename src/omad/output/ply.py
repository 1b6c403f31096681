"""Surfaces of the estimated parts, and the PLY files that hold them."""

from pathlib import Path

import numpy as np

from omad.common.files import write_atomic
from omad.estimation.estimate import Estimate
from omad.geometry.mesh import Mesh, convex_hull
from omad.geometry.rigid import box, carry
from omad.sensing.observation import Observation

from .frame import CAMERA, Frame
from .picture import part_colours

MARGIN = 0.1
"""Of a part's size: points farther from the box of its keypoints are taken for another part's."""


def part_surfaces(estimate: Estimate, observation: Observation | None = None) -> list[Mesh]:
    """A mesh for each part, canonical rest coordinates, metres. Where the weights have no surfaces it is the hull of
    the part's keypoints, and of the points that were seen of it where ``observation`` is given."""
    if estimate.surfaces is not None:
        return list(estimate.surface.parts)
    part_of = np.array(estimate.category.part_of_keypoint)
    meshes = []
    for part, T_camera_part in enumerate(estimate.T_camera_part):
        points = estimate.canonical_keypoints[part_of == part]
        if observation is not None:
            seen = carry(np.linalg.inv(T_camera_part), observation.points[estimate.part_labels == part].astype(float))
            low, high = box(points)
            margin = MARGIN * np.linalg.norm(high - low)
            inside = ((seen > low - margin) & (seen < high + margin)).all(1)
            points = np.concatenate([points, seen[inside]])
        meshes.append(convex_hull(points))
    return meshes


def byte_colours(estimate: Estimate) -> np.ndarray:
    """(K, 3) uint8, the colours of the parts in every picture."""
    return np.rint(255 * part_colours(np.arange(len(estimate.category.parts)))).astype(np.uint8)


def save_ply(
    estimate: Estimate, folder: str | Path, observation: Observation | None = None, frame: Frame = CAMERA
) -> list[Path]:
    """Write ``object.ply`` (all parts, coloured) and ``part-<name>.ply`` each: ``frame``, metres, estimated state,
    so that they lie on the observed cloud. Returns the files."""
    import trimesh  # slow to import

    folder, parts = Path(folder), {}
    places = frame.T_frame_camera @ estimate.T_camera_part
    of_parts = part_surfaces(estimate, observation), places, byte_colours(estimate)
    for spec, mesh, T, colour in zip(estimate.category.parts, *of_parts, strict=True):
        placed, rgba = mesh.carried(T), np.append(colour, 255).astype(np.uint8)
        shape = {"vertex_colors": np.tile(rgba, (len(mesh.vertices), 1)), "process": False}
        parts[folder / f"part-{spec.name}.ply"] = trimesh.Trimesh(placed.vertices, placed.faces, **shape)
    shapes = {folder / "object.ply": trimesh.util.concatenate(list(parts.values())), **parts}
    for path, shape in shapes.items():
        write_atomic(path, lambda temporary, shape=shape: shape.export(temporary, file_type="ply"))
    return list(shapes)
