"""Tracking where an object makes way for another of its category, seen from elsewhere."""

import numpy as np

import omad
from omad.data.procedural import generate
from omad.data.rendering.rasteriser import render
from omad.geometry.camera import STANDARD_CAMERA
from omad.objects.category_file import get_category

FRAMES = 8


def seen_from(azimuth: float) -> np.ndarray:
    """``T_camera_base`` of a camera that looks down at an object 1.75 m away."""
    eye = 1.6 * np.array([np.sin(azimuth), 0.45, np.cos(azimuth)])
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 1.0, 0.0]) / np.hypot(forward[0], forward[2])
    T_base_camera = np.eye(4)
    T_base_camera[:3] = np.stack([right, np.cross(forward, right), forward, eye], 1)
    return np.linalg.inv(T_base_camera)


def test_two_sure_answers_begin_a_track_where_its_own_explain_nothing():
    category = get_category("microwave")
    before, after = generate(category, 0, "test"), generate(category, 1, "test")
    tracker = omad.Tracker(omad.Estimator.from_pretrained("microwave", "cpu"))
    states = [(before, 0.3 + 0.02 * i, -0.6) for i in range(5)] + [(after, 0.5, 0.2 + 0.005 * i) for i in range(FRAMES)]
    found = []
    for index, (model, state, azimuth) in enumerate(states):
        depth = render(model, np.array([state]), seen_from(azimuth), STANDARD_CAMERA).depth
        found.append(tracker(omad.Observation.from_depth(depth, STANDARD_CAMERA), index / 30))
    assert [one.status for one in found[-4:]] == ["tracking"] * 4
    assert abs(found[-1].estimate.joint_states[0] - 0.5) < np.radians(5)
