"""An answer in the world frame, where the camera's place in it is known."""

from __future__ import annotations

from typing import Any

import numpy as np

from .estimate import Estimate


def in_world(estimate: Estimate, T_world_camera: np.ndarray) -> dict[str, Any]:
    """Poses, axes, pivots and keypoints of an estimate in the world frame, as plain values for JSON.

    ``T_world_camera`` (4, 4) takes camera coordinates to world coordinates. States do not depend on a frame.
    """
    R, t = T_world_camera[:3, :3], T_world_camera[:3, 3]
    names = [part.name for part in estimate.category.parts]
    return {
        "T_world_camera": T_world_camera.tolist(),
        "T_world_base": (T_world_camera @ estimate.T_camera_base).tolist(),
        "joints": [
            {
                "name": joint.name,
                "axis": (R @ joint.axis).tolist(),
                "pivot": None if joint.pivot is None else (R @ joint.pivot + t).tolist(),
            }
            for joint in estimate.joints
        ],
        "parts": [
            {"name": name, "T_world_part": (T_world_camera @ T).tolist()}
            for name, T in zip(names, estimate.T_camera_part, strict=True)
        ],
        "keypoints": (estimate.keypoints @ R.T + t).tolist(),
    }


def gravity_in_camera(T_world_camera: np.ndarray) -> np.ndarray:
    """(3,) where down is in the camera frame, for a world whose z points up."""
    return -T_world_camera[2, :3]
