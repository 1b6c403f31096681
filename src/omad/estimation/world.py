"""An answer in the world frame, where the camera's place in it is known."""

import math
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.geometry.rigid import carry, rigid_transform
from omad.sensing.reader import parse_numbers

from .estimate import Estimate, plain
from .known import Known

FAR = 100.0
"""Metres from the world's origin that no camera in a house is."""


def unit_doubts(T_world_camera: np.ndarray) -> list[str]:
    """What is strange about where a camera is, ``T_world_camera`` (4, 4)."""
    away = float(np.linalg.norm(T_world_camera[:3, 3]))
    cure = "translations are in metres: divide them by 1000 where these are millimetres"
    return [f"the camera is {away:.0f} m from the world's origin; {cure}"] if away > FAR else []


def in_world(estimate: Estimate, T_world_camera: Any) -> dict[str, Any]:
    """Poses, axes, pivots and keypoints of an estimate in the world frame, as plain values for JSON. ``T_world_camera``
    (4, 4), NumPy or torch, takes camera coordinates to world coordinates. States do not depend on a frame. Raises
    InputError for what is no rotation and translation."""
    T = rigid_transform(T_world_camera, "T_world_camera")
    parts = zip(estimate.category.parts, estimate.T_camera_part, strict=True)
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


def gravity_in_camera(T_world_camera: Any) -> np.ndarray:
    """(3,) where down is in the camera frame, for a world whose z points up; ``T_world_camera`` (4, 4) is as
    ``in_world`` takes it. Raises InputError."""
    return -rigid_transform(T_world_camera, "T_world_camera")[2, :3]


def known_gravity(told: str | None, T_world_camera: np.ndarray | None) -> Known:
    """What ``--gravity`` says: ``x,y,z``, where down is in the camera frame, or ``world``, of a world whose z points
    up. Raises InputError."""
    if told is None:
        return Known()
    if told != "world":
        down = parse_numbers(told, 3, "--gravity")
        if not 0 < math.hypot(*down) < math.inf:
            raise InputError(f"--gravity {told}: has no direction; give x,y,z in the camera frame")
        return Known(gravity=np.array(down))
    if T_world_camera is None:
        raise InputError("--gravity world: needs --world FILE (or --together) with T_world_camera, z up")
    return Known(gravity=gravity_in_camera(T_world_camera))
