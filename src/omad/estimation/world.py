"""An answer in the world frame, where the camera's place in it is known."""

from typing import Any

import numpy as np

from omad.geometry.rigid import carry

from .estimate import Estimate, plain


def in_world(estimate: Estimate, T_world_camera: np.ndarray) -> dict[str, Any]:
    """Poses, axes, pivots and keypoints of an estimate in the world frame, as plain values for JSON. ``T_world_camera``
    (4, 4) takes camera coordinates to world coordinates. States do not depend on a frame."""
    T, parts = T_world_camera, zip(estimate.category.parts, estimate.T_camera_part, strict=True)
    places = [None if joint.pivot is None else carry(T, joint.pivot) for joint in estimate.joints]
    joints = zip(estimate.joints, places, strict=True)
    return plain(
        {
            "T_world_camera": T,
            "T_world_base": T @ estimate.T_camera_base,
            "joints": [{"name": joint.name, "axis": T[:3, :3] @ joint.axis, "pivot": place} for joint, place in joints],
            "parts": [{"name": part.name, "T_world_part": T @ T_camera_part} for part, T_camera_part in parts],
            "keypoints": carry(T, estimate.keypoints),
        }
    )


def gravity_in_camera(T_world_camera: np.ndarray) -> np.ndarray:
    """(3,) where down is in the camera frame, for a world whose z points up."""
    return -T_world_camera[2, :3]
