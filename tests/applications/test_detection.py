"""Detection: scenes with truth, answers that are none, a box, and probabilities against their closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.special import softmax

import omad
from omad.applications.detection.detector import Detection, Detector, called, detect
from omad.applications.detection.judgement import Judgement
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS, ON
from omad.data.rendering.standard_views import standard_view
from omad.data.rendering.tabletop import Surroundings, Tabletop, TabletopObject, draw_tabletop
from omad.estimation.categories.fronts import front_says
from omad.estimation.categories.late import LateEstimator
from omad.estimation.checks import scaled
from omad.geometry.camera import STANDARD_CAMERA
from omad.model.fronts.network import shipped_front_net
from omad.objects.category_file import get_category
from omad.sensing.observation import Observation

NAMES = ("laptop", "eyeglasses")
SCENES = range(4)


def scene(index: int) -> Tabletop:
    return draw_tabletop(NAMES, (index, 5), "test", ON)


@cache
def answers(index: int) -> list[Detection]:
    drawn = scene(index)
    return omad.detect(drawn.depth, drawn.camera, NAMES)


def shared(found: Detection, placed: TabletopObject) -> float:
    mask = found.observation.mask
    assert mask is not None
    return float((mask & placed.mask).sum() / (mask | placed.mask).sum())


def test_most_objects_of_a_table_are_found_and_few_answers_are_false() -> None:
    there = found = named = right = 0
    for index in SCENES:
        objects = scene(index).objects
        sure = [one for one in answers(index) if one.category is not None]
        wanted = [placed for placed in objects if placed.category and placed.to_be_found]
        there, named = there + len(wanted), named + len(sure)
        found += sum(any(o.category == p.category and shared(o, p) > 0.5 for o in sure) for p in wanted)
        right += sum(any(o.category == p.category and shared(o, p) > 0.3 for p in objects) for o in sure)
    assert found >= 0.8 * there
    assert right >= 0.8 * named


def test_objects_on_a_table_over_a_floor_are_found() -> None:
    there = found = 0
    for index in range(2):
        drawn = draw_tabletop(NAMES, (index, 5), "test", ON, surroundings=Surroundings(raised=True))
        named = omad.detect(drawn.depth, drawn.camera, NAMES)
        wanted = [placed for placed in drawn.objects if placed.category and placed.to_be_found]
        there += len(wanted)
        found += sum(any(one.category == p.category and shared(one, p) > 0.5 for one in named) for p in wanted)
    assert there >= 4
    assert found >= 0.8 * there


def test_objects_before_a_camera_on_its_head_are_found_with_gravity_and_its_turn_is_told() -> None:
    drawn = draw_tabletop(("laptop",), (3, 5), "test", ON)
    camera = replace(
        drawn.camera, cx=drawn.camera.width - 1 - drawn.camera.cx, cy=drawn.camera.height - 1 - drawn.camera.cy
    )
    frame = omad.Observation.from_depth(np.ascontiguousarray(drawn.depth[::-1, ::-1]), camera)
    estimators = [LateEstimator.of("laptop")]
    level = Detector(estimators).look(omad.Observation.from_depth(drawn.depth, drawn.camera))
    assert level.support_plane is not None
    down = level.support_plane[:3] * (1, 1, -1)  # minus its normal, turned by half a turn about z
    turned = Detector(estimators, known=omad.Known(gravity=down)).look(frame)
    assert any("turned" in doubt for doubt in Detector(estimators).look(frame).doubts)
    assert not any("turned" in doubt for doubt in (*level.doubts, *turned.doubts))
    assert turned.support_plane is not None
    np.testing.assert_allclose(turned.support_plane, level.support_plane * (-1, -1, 1, 1), atol=0.01)
    found = [[one for one in look.detections if one.category] for look in (level, turned)]
    assert len(found[0]) == len(found[1]) > 0
    for one, other in zip(*found, strict=True):
        assert one.estimate is not None
        assert other.estimate is not None
        up, its_up = one.estimate.T_camera_base[:3, 1], other.estimate.T_camera_base[:3, 1] * (-1, -1, 1)
        assert np.degrees(np.arccos(np.clip(up @ its_up, -1, 1))) < 5
        assert np.degrees(np.abs(one.estimate.joint_states - other.estimate.joint_states)).max() < 5


@pytest.mark.parametrize(("name", "factor", "other"), [("laptop", 10.0, "refrigerator"), ("microwave", 0.1, "stapler")])
def test_a_scale_at_which_things_are_objects_is_named(name: str, factor: float, other: str) -> None:
    """Though at the one that was given they are as large as some other category's may be."""
    drawn, detector = draw_tabletop((name,), (5, 5)), Detector([LateEstimator.of(one) for one in (name, other)])
    frame = omad.Observation.from_depth(np.float32(factor) * drawn.depth, drawn.camera)
    look = detector.look(frame)
    assert not any(one.category for one in look.detections)
    [said] = detector.scale_doubts(look, 0.001 * factor)
    assert "at another scale" in said
    assert said.endswith(f"10 times too {'large' if factor > 1 else 'small'}; --depth-scale 0.001")
    true = detector.look(omad.Observation.from_depth(drawn.depth, drawn.camera))
    as_true = [one.probability for one in detector._at_scale(look, 1 / factor)]
    np.testing.assert_allclose(as_true, [one.probability for one in true.detections], atol=0.05)
    assert list(detector.scale_doubts(replace(true, detections=true.detections[-1:]), 0.001)) == []


def test_a_scale_is_named_of_an_object_that_was_cut_out_already() -> None:
    """Then what is taken for table or floor are its own plates."""
    category, detector = omad.get_category("laptop"), Detector([LateEstimator.of("laptop")])
    view = standard_view(generate(category, 3, "test"), category, (4, 3), LEVELS["on"])
    found = detector.look(view.observation())
    assert [one.category for one in found.detections] == ["laptop"]
    look = detector.look(scaled(view.observation(), 4.0))
    assert not any(one.category for one in look.detections)
    [said] = detector.scale_doubts(look, 0.001)
    assert said.endswith("5 or 4 times too large; --depth-scale 0.0002 or 0.00025")


def test_things_of_other_categories_speak_for_no_other_scale() -> None:
    drawn, detector = draw_tabletop(("stapler", "eyeglasses"), (1, 7)), Detector([LateEstimator.of("laptop")])
    look = detector.look(omad.Observation.from_depth(drawn.depth, drawn.camera))
    look = replace(look, detections=look.detections[:2])
    assert [one.category for one in look.detections] == [None, None]
    assert list(detector.scale_doubts(look, 0.001)) == []
    [said] = detector.scale_doubts(replace(look, detections=detector._at_scale(look, 100.0)), 0.1)
    assert "times too large" in said  # than anything


def test_where_no_table_was_told_from_what_stands_on_it_that_is_said() -> None:
    rows, columns = np.mgrid[:480, :640]
    across, along = (columns - 319.5) / 320, (rows - 239.5) / 240
    bowl = (1 + 0.4 * across**2 + 0.4 * along**2).astype(np.float32)
    ball = np.where(across**2 + along**2 < 0.9, 2 - 0.5 * np.sqrt(np.maximum(1 - across**2 - along**2, 0)), 2.5)
    inner = np.where((np.abs(across) < 0.8) & (np.abs(along) < 0.8), bowl, 0)
    said = [
        Detector([]).look(omad.Observation.from_depth(depth, STANDARD_CAMERA)).doubts
        for depth in (bowl, ball, inner, np.where(across < -0.5, ball, 2.5))
    ]
    assert ["no table, floor or wall was found" in " ".join(doubts) for doubts in said] == [True, False, False, False]
    assert ["holds 7" in " ".join(doubts) for doubts in said] == [False, True, False, False]


def test_every_thing_is_answered_and_says_how_sure_it_is() -> None:
    for index in SCENES:
        for one in answers(index):
            assert sum(one.probabilities.values()) == pytest.approx(1)
            assert one.probability == one.probabilities[one.category]
            assert (one.estimate is None) == (one.category is None)
            pixels, points = one.observation.pixels, one.observation.points
            assert pixels is not None
            assert np.allclose(scene(index).camera.project(points), pixels, atol=1e-2)
            assert one.box == (*pixels.min(0), *(pixels.max(0) + 1))
        boxes = [placed for placed in scene(index).objects if placed.category is None and placed.to_be_found]
        assert all(any(shared(one, placed) > 0.5 for one in answers(index)) for placed in boxes)


@pytest.mark.parametrize(
    ("probabilities", "name", "sure"),
    [
        ({"drawer": 0.61, None: 0.39}, "drawer", 0.61),
        ({None: 0.9, "drawer": 0.1}, "none of these", 0.9),
        ({"drawer_4": 0.4, "drawer_5": 0.3, "drawer": 0.2, None: 0.1}, "drawer_4 or drawer_5?", 0.7),
        ({"oven": 0.45, None: 0.4, "safe": 0.15}, "oven or none of these?", 0.85),
    ],
)
def test_categories_that_share_the_probability_are_all_named(probabilities, name, sure) -> None:
    one = replace(answers(0)[0], probabilities=probabilities, estimate=None)
    assert called(one.likely) == name
    assert one.likely_probability == pytest.approx(sure)
    assert one.to_dict()["likely"] == list(one.likely)


def test_a_box_says_where_to_look() -> None:
    drawn, whole = scene(0), answers(0)
    one = whole[0]
    assert one.box is not None
    inside = omad.detect(drawn.depth, drawn.camera, NAMES, one.box)
    assert {found.category for found in inside} >= {one.category}
    x1, y1, x2, y2 = one.box
    for found in inside:
        assert found.observation.mask is not None
        assert found.observation.mask[y1:y2, x1:x2].sum() == len(found.observation.points)


def test_a_box_holds_all_that_the_points_of_a_large_image_stand_for() -> None:
    frame = Observation.from_depth(np.full((1440, 1920), 2.0, np.float32), (1500, 1500, 959.5, 719.5))
    for box, expected in (((100, 100, 301, 301), (100, 100, 302, 302)), ((1700, 1300, 1920, 1440),) * 2):
        thing = frame.part(frame.inside(box))
        assert thing.mask is not None
        rows, columns = np.nonzero(thing.mask)
        found = Detection(thing, {None: 1.0}, None, {}).box
        assert found == expected == (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)


@pytest.mark.parametrize("categories", [None, 3, [None], {"laptop": 1, 2: 2}])
def test_categories_that_are_none_are_refused(categories: Any) -> None:
    with pytest.raises(InputError, match="categories: "):
        detect(np.ones((60, 80), np.float32), (100, 100, 40, 30), categories)


def test_a_cloud_has_no_box() -> None:
    drawn = scene(0)
    cloud = omad.Observation.from_points(omad.Observation.from_depth(drawn.depth, drawn.camera).points)
    detector = Detector([])
    assert len(detector(cloud)) == len(answers(0))
    assert all(found.category is None and found.probability == 1 for found in detector(cloud))
    assert [one.category for one in omad.detect(cloud, categories=NAMES)] == [one.category for one in answers(0)]
    with pytest.raises(omad.InputError, match="depth image"):
        detector(cloud, (0, 0, 5, 5))


class Nowhere(omad.Estimator):
    """Whose answers are no numbers, as of clouds far larger than the category."""

    def first_answers(self, *observed):
        lost = np.full((self.category.num_keypoints, 3), np.nan)
        return [replace(found, keypoints=lost, canonical_keypoints=lost) for found in super().first_answers(*observed)]


def test_an_answer_without_numbers_is_no_candidate() -> None:
    drawn = scene(0)
    frame = omad.Observation.from_depth(drawn.depth, drawn.camera)
    found = Detector([Nowhere.from_pretrained("laptop", "cpu")])(frame)
    assert found
    assert all(one.category is None and one.probabilities == {None: 1.0} for one in found)


def test_probabilities_are_a_softmax_with_none() -> None:
    rng = np.random.default_rng(0)
    weights, evidence = rng.random((2, 9)), rng.random((2, 9))
    judgement = Judgement({"a": weights[0].tolist(), "c": weights[1].tolist()}, {"a": 1.0, "c": 2.0})
    found = judgement.probabilities({"a": evidence[0], "own": evidence[1]})
    expected = softmax([1 - weights[0] @ evidence[0], 1.5 - weights.mean(0) @ evidence[1], 0.0])
    assert [found["a"], found["own"], found[None]] == pytest.approx(expected.tolist())
    assert list(found.values()) == sorted(found.values(), reverse=True)
    assert judgement.probabilities({"a": np.full(9, np.nan)}) == {None: 1.0, "a": 0.0}


def test_chests_are_told_apart_by_their_fronts() -> None:
    names = ("drawer_4", "drawer_5")
    judgement = Judgement(dict.fromkeys(names, [0.0] * 12 + [1.0]), {"drawer_4": 1.0, "drawer_5": 1.5})
    view = standard_view(generate(get_category("drawer_4"), 0, "test"), get_category("drawer_4"), (0, 0), ON)
    answers = {name: omad.Estimator.from_pretrained(name, "cpu")(view.observation()) for name in names}
    evidence = judgement.with_fronts(dict.fromkeys(names, np.zeros(12)), answers)
    assert [evidence[name][-1] for name in names] == pytest.approx(
        -front_says(list(answers.values()), np.array([1.0, 1.5]), shipped_front_net())
    )
    found = judgement.probabilities(evidence)
    assert found["drawer_4"] > 4 * found["drawer_5"]  # what else speaks against them says the other
    unknown = judgement.with_fronts({"kite": np.ones(12), "drawer_4": np.full(12, np.nan)}, answers)
    assert unknown["kite"].tolist() == [1.0] * 12 + [0.0]
    assert unknown["drawer_4"][-1] == 0.0


def test_what_an_observation_shows_is_found_as_what_its_depth_image_shows() -> None:
    drawn, there = scene(0), answers(0)
    frame = omad.Observation.from_depth(drawn.depth, drawn.camera)
    assert [one.box for one in omad.detect(frame, categories=NAMES)] == [one.box for one in there]
    one, same = omad.detect(frame, categories="laptop"), omad.detect(frame, categories=["laptop"])
    assert [found.probabilities for found in one] == [found.probabilities for found in same]
    with pytest.raises(omad.InputError):
        omad.detect(drawn.depth)
    with pytest.raises(omad.InputError, match="K: an Observation has its camera"):
        omad.detect(frame, drawn.camera, "laptop")
    with pytest.raises(omad.InputError, match=r"known: is list; give an omad\.Known"):
        omad.detect(frame, categories="laptop", known=[0, 1, 0])  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("index", [2, 3])
def test_of_an_object_that_was_cut_out_already_no_plane_is_taken_away(index: int) -> None:
    """Its lid or base is one; what is left of it looks like a laptop, too, but open otherwise."""
    laptop = get_category("laptop")
    view = standard_view(generate(laptop, index, "test"), laptop, (7, index), ON)
    [found] = omad.detect(view.observation(), categories="laptop")
    assert found.estimate is not None
    assert found.estimate.joint_states == pytest.approx(view.states, abs=0.1)
    assert len(found.observation.points) > 0.95 * len(view.observation().points)


def test_the_centre_is_the_middle_of_the_box_of_the_points_that_are_seen() -> None:
    """Wherever most of them lie."""
    rng = np.random.default_rng(0)
    points = np.r_[rng.uniform((0.0, 0.0, 1.0), (0.1, 0.1, 1.1), (900, 3)), [[-0.2, 0.0, 1.0], [0.4, 0.1, 1.5]]]
    told = Detection(omad.Observation.from_points(points), {None: 1.0}, None, {}).to_dict()
    assert told["centre"] == pytest.approx([0.1, 0.05, 1.25], abs=2e-3)


def test_only_categories_that_lie_flat_are_said_to_be_too_flat() -> None:
    """Scissors are a centimetre high on a table that is known to a few millimetres; refrigerators are not."""
    drawn = draw_tabletop(("laptop",), (3, 5), "test", ON)
    frame = omad.Observation.from_depth(drawn.depth, drawn.camera)
    look = Detector([LateEstimator.of(name) for name in ("refrigerator", "scissors", "oven")]).look(frame)
    assert look.too_flat == ("scissors",)


@pytest.mark.parametrize("quarter", [1, -1])
def test_objects_before_a_camera_that_lies_on_its_side_are_found_with_gravity(quarter: int) -> None:
    """A quarter turn is not its own inverse, as half a turn is."""
    drawn = draw_tabletop(("laptop",), (3, 5), "test", ON)
    depth, own = np.ascontiguousarray(np.rot90(drawn.depth, quarter)), drawn.camera
    cx, cy = (own.cy, own.width - 1 - own.cx) if quarter == 1 else (own.height - 1 - own.cy, own.cx)
    camera = replace(own, width=own.height, height=own.width, fx=own.fy, fy=own.fx, cx=cx, cy=cy)
    R = np.array([[0, quarter, 0], [-quarter, 0, 0], [0, 0, 1]], float)  # of a point before it was turned
    estimators = [LateEstimator.of("laptop")]
    level = Detector(estimators).look(omad.Observation.from_depth(drawn.depth, own))
    assert level.support_plane is not None
    known = omad.Known(gravity=R @ -level.support_plane[:3])
    turned = Detector(estimators, known=known).look(omad.Observation.from_depth(depth, camera))
    assert turned.support_plane is not None
    np.testing.assert_allclose(R.T @ turned.support_plane[:3], level.support_plane[:3], atol=0.01)
    assert turned.support_plane[3] == pytest.approx(level.support_plane[3], abs=0.01)
    one, other = (look.detections[0].estimate for look in (level, turned))  # of the likeliest
    assert one is not None
    assert other is not None
    assert np.linalg.norm(R @ one.T_camera_base[:3, 3] - other.T_camera_base[:3, 3]) < 0.05
    assert np.degrees(np.abs(one.joint_states - other.joint_states)).max() < 5
