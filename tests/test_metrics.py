"""Metrics against closed forms, and nothing dropped."""

import numpy as np
import pytest

from omad.metrics import ObjectPose, bootstrap_interval, missing_errors, pose_errors, summarise

REVOLUTE = np.array([True])
BOXES = np.array([[[-1.0, -1, -1], [1, 1, 1]], [[0.0, 0, 0], [2, 2, 2]]])


def pose(state=0.0, axis=(1.0, 0, 0), pivot=(0.0, 0, 0), turn=0.0, shift=(0.0, 0, 0)) -> ObjectPose:
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    T[:, :3, 3] = shift
    return ObjectPose(np.array([state]), np.array([axis]), np.array([pivot]), T)


def errors(estimate: ObjectPose):
    return pose_errors(estimate, pose(), BOXES, REVOLUTE, unit=0.5)


def test_the_truth_has_no_error():
    found = errors(pose())
    for values in (found.joint_state, found.axis, found.axis_distance, found.pivot_distance, found.rotation):
        assert values == pytest.approx(0, abs=1e-7)
    assert found.within(np.radians(5), 0.05)


def test_axis_angle_is_directed():
    assert np.degrees(errors(pose(axis=(-1.0, 0, 0))).axis[0]) == pytest.approx(180)
    assert np.degrees(errors(pose(axis=(0.0, 1, 0))).axis[0]) == pytest.approx(90)


def test_axis_distance_is_between_lines_and_pivot_distance_is_not_fooled_by_crossing_axes():
    parallel = errors(pose(pivot=(5.0, 0.3, 0.4)))
    assert parallel.axis_distance[0] == pytest.approx(0.5)
    skew = errors(pose(axis=(0.0, 1, 0), pivot=(0.0, 0, 0.2)))
    assert skew.axis_distance[0] == pytest.approx(0.2)
    crossing = errors(pose(axis=(0.0, 1, 0), pivot=(0.0, 0.7, 0)))
    assert crossing.axis_distance[0] == pytest.approx(0)
    assert crossing.pivot_distance[0] == pytest.approx(0.7)


def test_part_errors_are_at_the_part_box_centre():
    turned = errors(pose(turn=np.pi / 6))
    assert np.degrees(turned.rotation) == pytest.approx([30, 30])
    arm = np.sqrt(2)  # the second part's centre (1, 1, 1) is this far from the axis of the turn
    assert turned.translation == pytest.approx([0, 2 * arm * np.sin(np.pi / 12)])
    assert errors(pose(shift=(0, 0, 0.1))).translation == pytest.approx([0.1, 0.1])


def test_not_finite_counts_as_missing():
    found = errors(pose(state=np.nan))
    assert found.missing
    assert np.degrees(found.joint_state[0]) == pytest.approx(90)
    assert found.axis_distance[0] == 0.5
    prismatic = missing_errors(2, np.array([False]), 0.5)
    assert prismatic.joint_state[0] == 0.5
    assert np.isnan(prismatic.axis_distance[0])


def test_summary_keeps_missing_views_in_the_mean():
    good, bad = errors(pose(state=np.radians(2))), errors(pose(state=np.nan))
    table = summarise([good, good, good, bad], np.ones(4), REVOLUTE)
    assert table["joint_state_error_deg"][0]["mean"] == pytest.approx((3 * 2 + 90) / 4)
    assert table["joint_state_error_deg"][0]["median"] == pytest.approx(2)
    assert table["joint_state_error"] == [None]
    assert table["within_5deg_5percent"] == 0.75


def test_bootstrap_resamples_objects_not_views():
    values = np.array([1.0] * 50 + [3.0] * 50)
    low, high = bootstrap_interval(values, np.repeat(["a", "b"], 50))
    assert (low, high) == (1.0, 3.0)  # two objects: any draw may hold one of them only
    assert bootstrap_interval(np.ones(10), np.arange(10)) == (1.0, 1.0)
