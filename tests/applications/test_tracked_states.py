"""What a track tells of its frames: tables and errors of several joints; what it believes of covariance and shape."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import omad
from helpers.command_line import save_png
from omad.applications.tracking.sequence import TrackedSequence, summarise
from omad.applications.tracking.tracker import TrackedStates, TrackerConfig, evidence
from omad.cli.main import run
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.objects.category_file import get_category

DRAWER = get_category("drawer")


@pytest.fixture(scope="module")
def cabinet() -> tuple[omad.Observation, omad.Estimate]:
    observation = standard_view(generate(DRAWER, 3, "test"), DRAWER, (1, 3)).observation()
    return observation, replace(omad.Estimator.from_pretrained("drawer", "cpu")(observation), probability=0.99)


class Says(omad.Estimator):
    """The same to whatever it is asked, until it is told otherwise."""

    answer: omad.Estimate

    def __call__(self, *_: Any) -> omad.Estimate:  # type: ignore[override]
        return self.answer

    def near(self, *_: Any) -> omad.Estimate:
        return self.answer


@pytest.fixture
def says(cabinet) -> Says:
    says = Says(omad.Estimator.from_pretrained("drawer", "cpu").net)
    says.answer = cabinet[1]
    return says


def told(states: list[float], spread: float, single: list[float]) -> TrackedStates:
    return TrackedStates(0.0, "tracking", False, 0.9, False, np.array([states, [spread] * len(states), single]))


def test_the_table_names_every_number_of_every_joint(tmp_path):
    tracked = told([0.1, 0.2, 0.3], 0.01, [0.4, 0.5, 0.6])
    frame, file = SimpleNamespace(path=Path("00000.png"), time=0.0), tmp_path / "states.csv"
    TrackedSequence._table(SimpleNamespace(files=[frame], tracked=[tracked]), file, DRAWER)  # type: ignore[arg-type]
    [row] = csv.DictReader(file.read_text(encoding="utf-8").splitlines())
    for joint, spec in enumerate(DRAWER.joints):
        found = [float(row[f"{spec.name}{of}"]) for of in ("", "_std", "_single")]
        assert found == pytest.approx(tracked.told[:, joint])


def test_errors_are_those_of_tracked_and_of_single_answers():
    tracked = [told([0.1, 0, 0], 0.01, [0.4, 0, 0]), told([-0.1, 0, 0], 0.01, [0.4, 0, 0])]
    first, *others = summarise(DRAWER, tracked, [[0.0] * 3] * 2)["errors"]
    assert (first["tracked"]["mean"], first["single"]["mean"]) == pytest.approx((0.1, 0.4))
    assert (first["tracked"]["jitter"], first["single"]["jitter"]) == pytest.approx((0.0, 0.0))
    assert [other["single"]["mean"] for other in others] == [0.0, 0.0]


def test_evidence_is_the_mean_log_density_of_keypoints(cabinet):
    from scipy.stats import norm

    estimate = cabinet[1]
    wider = replace(estimate, keypoint_std=2 * estimate.keypoint_std)
    apart = estimate.observed_keypoints - estimate.keypoints
    densities = [norm.logpdf(apart, scale=one.keypoint_std[:, None]).sum(1).mean() for one in (estimate, wider)]
    assert evidence(estimate) - evidence(wider) == pytest.approx(densities[0] - densities[1])


def test_a_second_frame_makes_it_no_less_sure(says, cabinet):
    tracker = omad.Tracker(says)
    first, second = tracker(cabinet[0], 0.0).estimate, tracker(cabinet[0], 0.001).estimate
    variances = [each.covariance.diagonal()[:9] for each in (first, second)]
    assert (variances[1] < 1.001 * variances[0]).all()


def test_another_objects_shape_takes_the_place_of_the_one_before(says, cabinet):
    observation, before = cabinet
    tracker = omad.Tracker(says)
    tracker(observation, 0.0)
    far = before.beta + 50 * np.sqrt(before.covariance.diagonal()[-len(before.beta) :])
    says.answer = replace(before, beta=far)
    later = 10 * TrackerConfig().lost_after
    found = [tracker(seen, later + t) for t, seen in enumerate((None, observation, observation))]
    assert [one.status for one in found] == ["lost", "lost", "tracking"]
    np.testing.assert_allclose(tracker.shape.mean, far)
    assert tracker.shape.views == pytest.approx(1)


def test_a_slide_by_a_unit_shows_as_much_of_the_shape_as_a_turn_by_a_radian(says, cabinet, monkeypatch):
    observation, before = cabinet
    tracker, moved = omad.Tracker(says), []
    first = tracker(observation, 0.0).estimate
    monkeypatch.setattr(tracker.shape, "count", lambda by: moved.append(by) or 0.0)
    states = before.placed.states + [0.01, 0, 0]
    joints = (replace(before.joints[0], state=states[0]), *before.joints[1:])
    says.answer = replace(before, placed=replace(before.placed, states=states), joints=joints)
    second = tracker(observation, 0.1).estimate
    by = (second.joint_states - first.joint_states) / DRAWER.metres_per_unit
    assert moved == [pytest.approx(np.linalg.norm(by), rel=0.05)]
    assert abs(by[0]) > 0.005


def test_a_new_track_is_challenged_soon_and_then_less_and_less_often(says, cabinet, monkeypatch):
    cold = list[int]()
    monkeypatch.setattr(Says, "__call__", lambda self, *_: cold.append(frame) or self.answer)
    tracker = omad.Tracker(says)
    for frame in range(50):
        tracker(cabinet[0], frame / 15)
    assert cold == [0, 1, 3, 7, 15, 30, 45]


def test_what_spoke_against_a_track_in_a_frame_that_it_missed_is_remembered(says, cabinet, monkeypatch):
    observation, right = cabinet
    aside = np.eye(4)
    aside[0, 3] = 1.0
    placed = replace(right.placed, T_camera_part=aside @ right.placed.T_camera_part)
    poor = right.observed_keypoints + 0.05 * right.category.metres_per_unit  # two nats worse and more
    wrong = replace(right, observed_keypoints=poor)
    elsewhere = replace(
        right, placed=placed, keypoints=right.keypoints + aside[:3, 3],
        observed_keypoints=right.observed_keypoints + aside[:3, 3],
    )  # fmt: skip
    assert evidence(elsewhere) > evidence(wrong) + 1
    says.answer, near = wrong, [replace(wrong, residual=np.inf), wrong]
    tracker = omad.Tracker(says)
    assert tracker(observation, 0.0).restarted
    monkeypatch.setattr(Says, "near", lambda self, *_: near.pop(0))
    says.answer = elsewhere
    found = [tracker(observation, time) for time in (0.1, 0.2)]
    assert [(one.status, one.restarted) for one in found] == [("coasting", False), ("tracking", True)]
    np.testing.assert_allclose(found[1].estimate.T_camera_base, elsewhere.T_camera_base, atol=1e-6)


GIVEN = ["--category", "laptop", "--intrinsics", "600,600,319.5,239.5", "--json"]  # already in test_tracking.py


def test_rate_and_a_static_base_are_taken_from_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for index in range(6):
        save_png(f"still/{index:04d}.png")

    def lines(*options: str) -> list[dict]:
        assert run(["track", "still", *options, *GIVEN]) == 0
        return [json.loads(line) for line in Path("omad-track/frames.jsonl").read_text().splitlines()]

    moving, static = lines("--fps", "10"), lines("--fps", "10", "--static-base")
    assert np.diff([line["time"] for line in moving]) == pytest.approx([0.1] * 5)
    assert np.diff([line["time"] for line in lines()]) == pytest.approx([1 / 30] * 5)
    assert (np.array(static[-1]["base_std"]) < 0.9 * np.array(moving[-1]["base_std"])).all()
    assert moving[-1]["base_std"] != moving[0]["base_std"]
