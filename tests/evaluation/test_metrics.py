"""Metrics against closed forms, and nothing dropped."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.categories import DRAWER, EYEGLASSES, LAPTOP, SCISSORS
from omad.common.errors import InputError
from omad.evaluation.evaluate import Measured, summary
from omad.evaluation.metrics import bootstrap_interval, missing_errors, pose_errors, summarise
from omad.objects.pose import ObjectPose

HALF = replace(LAPTOP, metres_per_unit=0.5)
BOXES = np.array([[[-1.0, -1, -1], [1, 1, 1]], [[0.0, 0, 0], [2, 2, 2]]])


def pose(state=0.0, axis=(1.0, 0, 0), pivot=(0.0, 0, 0), turn=0.0, shift=(0.0, 0, 0)) -> ObjectPose:
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    T[:, :3, 3] = shift
    return ObjectPose(np.array([state]), np.array([axis]), np.array([pivot]), T)


def errors(estimate: ObjectPose):
    return pose_errors(estimate, pose(), BOXES, HALF)


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
    found = errors(pose(state=np.nan, axis=(np.nan, 0, 0), turn=np.nan))
    assert found.missing
    assert np.degrees(found.joint_state[0]) == pytest.approx(90)
    assert np.degrees(found.axis[0]) == pytest.approx(90)
    assert found.axis_distance[0] == 0.5
    assert np.degrees(found.rotation) == pytest.approx([90, 90])
    prismatic = missing_errors(DRAWER)
    assert prismatic.joint_state[0] == DRAWER.metres_per_unit
    assert np.isnan(prismatic.axis_distance[0])


def test_a_missing_part_leaves_the_others_their_own_errors():
    partly = pose()
    partly.T_camera_part[1] = np.nan
    found = errors(replace(partly, states=np.array([np.nan])))
    assert found.missing
    assert np.degrees(found.joint_state[0]) == pytest.approx(90)
    assert found.axis[0] == found.axis_distance[0] == 0
    assert np.degrees(found.rotation) == pytest.approx([0, 90])
    assert found.translation == pytest.approx([0, 0.5])


def test_summary_keeps_missing_views_in_the_mean():
    good, bad = errors(pose(state=np.radians(2))), errors(pose(state=np.nan, turn=np.nan))
    table = summarise([good, good, good, bad], np.ones(4), HALF)
    assert table["joint_state_error_deg"][0]["mean"] == pytest.approx((3 * 2 + 90) / 4)
    assert table["joint_state_error_deg"][0]["median"] == pytest.approx(2)
    assert table["joint_state_error"] == [None]
    assert table["within_5deg_5percent"] == 0.75


def test_bootstrap_resamples_objects_not_views():
    values = np.array([1.0] * 50 + [3.0] * 50)
    low, high = bootstrap_interval(values, np.repeat(["a", "b"], 50))
    assert (low, high) == (1.0, 3.0)  # two objects: any draw may hold one of them only
    assert bootstrap_interval(np.ones(10), np.arange(10)) == (1.0, 1.0)
    assert bootstrap_interval(values, np.full(100, "a")) is None  # one object does not tell how others differ


def test_swapped_labels_of_scissors_are_no_error():
    opened = pose(state=-0.4, axis=(0.0, 1, 0))
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(0.4), 0, -np.sin(0.4)], [0, 1, 0], [np.sin(0.4), 0, np.cos(0.4)]]  # -0.4 about +y
    opened = replace(opened, T_camera_part=np.stack([np.eye(4), turn]))
    other = opened.swapped()
    assert other.axes == pytest.approx(-opened.axes)
    # seen from its own base, the child still turns by -0.4 about +y
    relative = np.linalg.inv(other.T_camera_part[0]) @ other.T_camera_part[1]
    assert relative == pytest.approx(turn)
    found = pose_errors(other, opened, BOXES, SCISSORS)
    for values in (found.joint_state, found.axis, found.axis_distance, found.rotation, found.translation):
        assert values == pytest.approx(0, abs=1e-6)
    assert np.degrees(pose_errors(other, opened, BOXES, LAPTOP).axis[0]) == pytest.approx(180)


def test_glasses_seen_from_behind_are_flipped_and_their_temples_swapped():
    boxes = np.array([[[-7.0, -2, 5], [7, 2, 5]], [[6.0, 0, -5], [7, 1, 5]], [[-7.0, 0, -5], [-6, 1, 5]]])
    T = np.tile(np.eye(4), (3, 1, 1))
    truth = ObjectPose(np.zeros(2), np.array([[0.0, 1, 0]] * 2), np.array([[6.5, 0, 5], [-6.5, 0, 5]]), T)
    turned = replace(truth, T_camera_part=T @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    found = [pose_errors(estimate, truth, boxes, EYEGLASSES) for estimate in (truth, turned)]
    assert [(e.flipped, e.swapped) for e in found] == [(False, False), (True, True)]
    table = summarise(found, np.ones(2), EYEGLASSES)
    assert (table["flipped"], table["swapped"]) == (0.5, 0.5)
    assert missing_errors(EYEGLASSES).flipped


def test_no_results_make_no_summary():
    with pytest.raises(InputError, match="nowhere: none of its views"):
        summary([], LAPTOP, "nowhere")


def test_within_asks_for_angle_and_length():
    near, far = errors(pose(shift=(0, 0, 0.04))), errors(pose(shift=(0, 0, 0.06)))
    assert [each.within(np.radians(5), 0.05) for each in (near, far)] == [True, False]
    assert summarise([near, far], np.ones(2), HALF)["within_5deg_5percent"] == 0.5


def test_p90_is_exceeded_by_a_tenth():
    table = summarise([errors(pose(state=np.radians(state))) for state in range(11)], np.ones(11), HALF)
    assert table["joint_state_error_deg"][0]["p90"] == pytest.approx(9)


def test_objects_count_as_often_as_they_are_seen():
    values, groups = np.array([0.0] * 90 + [1.0] * 9), np.array(["a"] * 90 + list("bcdefghij"))
    low, high = bootstrap_interval(values, groups)
    assert low < 0.1 < high  # a mean over objects would be 0.6 at least


def test_a_summary_keeps_objects_and_stages_apart():
    far, near = errors(pose(shift=(0, 0, 0.08))), errors(pose(state=np.radians(4)))
    views = [Measured("a", 1.0, far, near, None), Measured("b", 2.0, near, far, None)]
    found = summary(views, HALF, "here")
    assert found["initial"]["joint_state_error_deg"][0]["mean"] == pytest.approx(2)
    assert [each["refined"]["within_5deg_5percent"] for each in found["by_object"]] == [1.0, 1.0]  # 8 % of 1, 4 % of 2
    assert found["interval"]["joint_state_error_deg"][0] == pytest.approx((0, 4))


def test_stages_differ():
    found = summary([Measured("a", 1.0, errors(pose(state=0.5)), errors(pose(state=0.1)), None)] * 2, HALF, "here")
    assert found["initial"]["joint_state_error_deg"][0]["mean"] == pytest.approx(np.degrees(0.5))
