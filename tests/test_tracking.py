"""Following an object through frames: the filter, and what is believed of a shape."""

import numpy as np

from omad.tracking.motion import MotionConfig, MotionFilter, Placement
from omad.tracking.shape_belief import ShapeBelief, ShapeConfig


def test_filter_is_the_textbook_one():
    """A sliding joint is linear: a Kalman filter of two numbers, written out."""
    config = MotionConfig(decay=2.0)
    P, R, dt = np.diag([0.01, config.prismatic**2 * 2.0]), 0.02, 0.1
    ours = MotionFilter(config, (False,), Placement(np.eye(4), np.zeros(1)), 0.01 * np.eye(7))
    x, k = np.zeros(2), np.exp(-dt / 2.0)
    F = np.array([[1, 2.0 * (1 - k)], [0, k]])
    Q = config.prismatic**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    for measured in (0.05, 0.08, 0.2):
        ours.predict(dt)
        ours.update(Placement(np.eye(4), np.array([measured])), R * np.eye(7))
        x, P = F @ x, F @ P @ F.T + Q
        gain = P[:, 0] / (P[0, 0] + R)
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
