"""What is believed of an object from frame to frame: the filter of its motion, and its shape."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omad.applications.tracking.motion import SUREST, MotionConfig, MotionFilter, Placement
from omad.applications.tracking.shape_belief import ShapeBelief, ShapeConfig
from omad.common.errors import InputError
from omad.geometry.rigid import rigid


def test_filter_is_the_textbook_one():
    """A sliding joint is linear: a Kalman filter of two numbers, written out."""
    config = MotionConfig(decay=2.0)
    P, R, dt = np.diag([0.01, config.sliding**2 * 2.0]), 0.02, 0.1
    ours = MotionFilter(config, (False,), Placement(np.eye(4), np.zeros(1)), 0.01 * np.eye(7))
    x, k = np.zeros(2), np.exp(-dt / 2.0)
    F = np.array([[1, 2.0 * (1 - k)], [0, k]])
    Q = config.sliding**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    for measured in (0.05, 0.08, 0.2):
        ours.predict(dt)
        ours.update(Placement(np.eye(4), np.array([measured])), R * np.eye(7))
        x, P = F @ x, F @ P @ F.T + Q
        gain = P[:, 0] / (P[0, 0] + R + SUREST**2)
        x, P = x + gain * (measured - x[0]), P - np.outer(gain, P[0])
        np.testing.assert_allclose([ours.placement.joint_states[0], ours.velocity[6]], x)
        assert np.isclose(ours.covariance[6, 6], P[0, 0])


def test_placement_steps_invert():
    start = Placement(np.eye(4), np.zeros(2))
    step = np.array([0.3, -0.2, 0.1, 1, 2, 3, 0.5, -0.5])
    np.testing.assert_allclose(start.step_to(start.moved(step)), step)


def test_a_static_base_only_gets_surer():
    ours = MotionFilter(MotionConfig(static_base=True), (True,), Placement(np.eye(4), np.zeros(1)), np.eye(7))
    ours.predict(1.0)
    np.testing.assert_allclose(np.diag(ours.covariance)[:6], 1)
    assert ours.covariance[6, 6] > 1


def test_a_static_base_on_a_known_vertical_is_followed():
    """No measurement lets it turn but about the vertical, which the covariances say with zeros."""
    covariance = np.diag([0.0, 1e-4, 0.0, 1e-6, 1e-6, 1e-6, 1e-4])
    ours = MotionFilter(MotionConfig(static_base=True), (True,), Placement(np.eye(4), np.zeros(1)), covariance)
    for measured in (0.3, 0.5, 0.5, 0.5):
        ours.predict(0.2)
        there = Placement(np.eye(4), np.array([measured]))
        assert 0 < ours.surprise(there, covariance) < 10
        ours.update(there, covariance)
    assert ours.placement.joint_states[0] == pytest.approx(0.5, abs=0.02)
    far = Placement(rigid(Rotation.from_rotvec([0.05, 0, 0]).as_matrix(), np.zeros(3)), np.array([0.5]))
    assert ours.surprise(far, covariance) > 1000


def test_one_viewpoint_tells_of_the_shape_once():
    belief = ShapeBelief(ShapeConfig(most_views=2.0), np.zeros(2), np.eye(2))
    belief.update(np.ones(2), np.eye(2) / 3, belief.count(0.0))
    np.testing.assert_allclose(belief.mean, 1)
    for _ in range(20):
        belief.update(belief.mean, np.linalg.inv(np.linalg.inv(belief.covariance) + np.eye(2)), belief.count(0.0))
    np.testing.assert_allclose(belief.covariance, np.eye(2) / 3)
    for _ in range(20):
        belief.update(belief.mean, np.linalg.inv(np.linalg.inv(belief.covariance) + 2 * np.eye(2)), 1.0)
    assert belief.views <= 2 + 1e-9
    np.testing.assert_allclose(belief.covariance, np.eye(2) / 5, rtol=1e-6)


def test_a_cold_start_adds_to_what_is_known_of_the_shape():
    """Its prior is the category's, however much is believed already."""
    prior, seen, truth = np.eye(2), 20 * np.eye(2), np.array([1.0, -1.0])
    belief = ShapeBelief(ShapeConfig(most_views=20.0), np.zeros(2), prior)
    for _ in range(5):
        before = np.linalg.inv(belief.covariance)
        posterior = np.linalg.inv(before + seen)
        belief.update(posterior @ (before @ belief.mean + seen @ truth), posterior, 1.0)
    posterior = np.linalg.inv(prior + seen)
    belief.update(posterior @ seen @ truth, posterior, 1.0, cold=True)
    np.testing.assert_allclose(belief.covariance, np.eye(2) / (1 + 6 * 20))
    np.testing.assert_allclose(belief.mean, truth * 120 / 121)


def test_a_belief_that_counts_no_view_is_refused():
    for settings in ({"new_view": 0.0}, {"most_views": 0.5}):
        with pytest.raises(InputError, match="ShapeConfig: new_view must be above 0"):
            ShapeConfig(**settings)
