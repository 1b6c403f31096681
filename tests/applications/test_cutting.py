"""The object found in a whole frame: rendered tables with truth, boxes around each object, and frames without one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import omad
from omad.applications.detection.cutting import ObjectFinder
from omad.applications.detection.detector import Detector, measured_margin
from omad.applications.solver import Solver
from omad.common.errors import NothingSeen
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import standard_view
from omad.data.rendering.tabletop import Tabletop, TabletopObject, draw_tabletop
from omad.estimation.known import Known
from omad.geometry.camera import STANDARD_CAMERA
from omad.objects.category_file import get_category
from omad.sensing.observation import Observation

SCENES = range(3)


@cache
def finder(name: str) -> ObjectFinder:
    return ObjectFinder(Detector([omad.Estimator.from_pretrained(name)]))


@cache
def scene(index: int) -> Tabletop:
    return draw_tabletop(("laptop", "eyeglasses"), (index, 5), "test", ON)


def frame(index: int) -> Observation:
    drawn = scene(index)
    return Observation.from_depth(drawn.depth, drawn.camera)


def shared(seen: Observation, placed: TabletopObject, measured: np.ndarray) -> float:
    truth = placed.mask & measured
    assert seen.mask is not None
    return float((seen.mask & truth).sum() / (seen.mask | truth).sum())


def box_around(placed: TabletopObject) -> tuple[float, float, float, float]:
    """With a tenth of its size to every side, so that table and neighbours are in it."""
    rows, columns = np.nonzero(placed.mask)
    wide, high = 0.1 * np.ptp(columns), 0.1 * np.ptp(rows)
    return columns.min() - wide, rows.min() - high, columns.max() + 1 + wide, rows.max() + 1 + high


def test_a_box_around_an_object_gives_that_object() -> None:
    right = []
    for index in SCENES:
        drawn, whole = scene(index), frame(index)
        for placed in drawn.objects:
            if placed.category and placed.to_be_found:
                found = finder(placed.category)(whole, box_around(placed))
                right.append(shared(found, placed, drawn.depth > 0) > 0.7)
    assert len(right) >= 5
    assert sum(right) >= len(right) - 1


def test_a_box_that_cuts_its_object_is_told_of() -> None:
    placed = next(placed for placed in scene(0).objects if placed.category == "laptop")
    x1, y1, x2, y2 = box_around(placed)
    told = [finder("laptop")(frame(0), (x1, y1, end, y2)).warnings for end in (x2, (x1 + 2 * x2) / 3)]
    assert ["give a larger box" in " ".join(warnings) for warnings in told] == [False, True]


def test_without_a_box_one_of_the_category_is_taken_and_others_are_told_of() -> None:
    told_right = []
    for index in SCENES:
        drawn, whole = scene(index), frame(index)
        for name in ("laptop", "eyeglasses"):
            there = [placed for placed in drawn.objects if placed.category == name and placed.to_be_found]
            if there:
                found = finder(name)(whole)
                assert max(shared(found, placed, drawn.depth > 0) for placed in there) > 0.5
                told = any("more than one" in warning for warning in found.warnings)
                told_right.append(told == (len(there) > 1))
    assert len(told_right) == 4
    assert sum(told_right) >= 3  # one of the laptops is all but shut: rather a flat box


def test_of_several_categories_the_others_are_named() -> None:
    both = [omad.Estimator.from_pretrained(name) for name in ("laptop", "eyeglasses")]
    told = " ".join(ObjectFinder(Detector(both))(frame(0)).warnings)
    assert "more than one object of the categories is seen: the likeliest, " in told
    assert any(f"({name}, " in told for name in ("laptop", "eyeglasses"))


def test_where_there_is_none_it_is_said_with_a_cure() -> None:
    for name in ("dishwasher", "scissors"):
        with pytest.raises(NothingSeen, match=f"no {name}.*(mask|box).*omad detect"):
            finder(name)(frame(0))
    table = np.tile((1 / np.linspace(0.5, 1, 480, dtype=np.float32))[:, None], 640)
    upright = Detector([omad.Estimator.from_pretrained("dishwasher")], known=omad.Known(gravity=np.array([0, 1.0, 0])))
    with pytest.raises(NothingSeen, match="check gravity, or give a mask"):
        ObjectFinder(upright)(frame(0))
    with pytest.raises(NothingSeen, match="nothing stands"):
        finder("laptop")(Observation.from_depth(table, STANDARD_CAMERA))


def test_one_thing_of_the_wrong_size_is_told_of_as_one() -> None:
    depth = np.full((480, 640), 1.0, dtype=np.float32)
    depth[200:260, 300:360] = 0.9
    with pytest.raises(NothingSeen, match=r"no dishwasher: the one thing that stands before .* is 0.1. m large"):
        finder("dishwasher")(Observation.from_depth(depth, STANDARD_CAMERA))


def test_an_object_that_was_cut_out_already_is_left_as_it_is() -> None:
    placed = next(placed for placed in scene(0).objects if placed.category == "eyeglasses")
    alone = Observation.from_depth(np.where(placed.mask, scene(0).depth, 0), scene(0).camera)
    assert measured_margin(alone) < 0.1
    assert finder("eyeglasses")(alone) is alone
    x1, y1, x2, y2 = box = box_around(placed)
    half = finder("eyeglasses")(alone, ((x1 + x2) / 2, y1, x2, y2))
    expected = Observation.from_depth(alone.depth, scene(0).camera, box=((x1 + x2) / 2, y1, x2, y2))
    assert np.array_equal(half.mask, expected.mask)
    assert np.array_equal(half.points, expected.points)
    assert len(finder("eyeglasses")(alone, box).points) == len(alone.points)
    assert measured_margin(frame(0)) > 0.5
    assert measured_margin(Observation.from_points(alone.points)) == 0


def test_an_object_with_a_little_of_its_table_is_cut_out() -> None:
    found = []
    for index in SCENES:
        drawn = scene(index)
        for placed in drawn.objects:
            if not placed.category or not placed.to_be_found:
                continue
            rows, columns = np.nonzero(placed.mask)
            high, wide = np.ceil(0.4 * np.array([np.ptp(rows), np.ptp(columns)])).astype(int)
            shown = np.zeros_like(placed.mask)
            left, top = max(columns.min() - wide, 0), max(rows.min() - high, 0)
            shown[top : rows.max() + high, left : columns.max() + wide] = True
            little = Observation.from_depth(np.where(shown, drawn.depth, 0), drawn.camera)
            if measured_margin(little) < 0.4:
                boxes = (None, (left, top, columns.max() + wide, rows.max() + high))
                found += [shared(finder(placed.category)(little, box), placed, drawn.depth > 0) > 0.7 for box in boxes]
    assert len(found) >= 12
    assert sum(found) >= 0.7 * len(found)  # of a laptop seen flat only the lid may be left


def test_an_answer_is_no_surer_than_that_the_thing_is_the_object() -> None:
    estimator = omad.Estimator.from_pretrained("laptop")
    solver = Solver(estimator, lambda: [estimator])
    placed = next(placed for placed in scene(1).objects if placed.category == "laptop")
    found = finder("laptop")(frame(1), box_around(placed))
    assert 0.5 < found.likelihood < 1
    sure, unsure = (solver(one, None) for one in (found, replace(found, likelihood=0.3)))
    assert not sure.doubtful
    assert sure.estimate.probability <= found.likelihood
    assert unsure.doubtful
    assert unsure.estimate.probability == 0.3
    served = solver.judged(replace(found, likelihood=0.3), sure.estimate, None, further=False)  # as a service asks
    assert served.estimate.probability == 0.3


def test_an_answer_of_any_category_is_right_only_if_that_is_its_category() -> None:
    estimators = [omad.Estimator.from_pretrained(name) for name in ("laptop", "scissors")]
    category = get_category("laptop")
    for index in range(3):
        seen = standard_view(generate(category, index, "test"), category, (index, 3)).observation()
        alone, any_ = (Solver(one, lambda: estimators)(seen, None) for one in (estimators[0], None))
        own, first = alone.estimate.probability, any_.ranking.candidates[0]
        assert first.estimate.category.name == "laptop"
        assert any_.estimate.probability == pytest.approx(own * first.probability)


def test_of_any_category_wrong_cameras_and_gravity_are_doubted_as_of_one() -> None:
    estimator, category = omad.Estimator.from_pretrained("laptop"), get_category("laptop")
    seen = standard_view(generate(category, 0, "test"), category, (0, 0)).observation()
    turned = Rotation.from_euler("z", 40, degrees=True).apply(-estimator(seen).T_camera_base[:3, 1])
    narrow = replace(seen, points=seen.points * np.float32([1.5, 1.5, 1]))
    for view, known, name in ((seen, Known(gravity=turned), "gravity"), (narrow, Known(), "intrinsics")):
        for chosen in (estimator, None):
            found = Solver(chosen, lambda: [estimator], known)(view, None)
            assert found.doubtful
            assert name in [check.name for check in found.checks]
    few = Solver(None, lambda: [estimator])(narrow, None, further=False)
    assert "intrinsics" not in [check.name for check in few.checks]


def test_an_object_that_was_cut_out_already_is_found_in_the_frame_that_shows_it_alone() -> None:
    placed = next(placed for placed in scene(1).objects if placed.category == "laptop")
    alone = Observation.from_depth(np.where(placed.mask, scene(1).depth, 0), scene(1).camera)
    found = Detector([omad.Estimator.from_pretrained("laptop")])(alone)
    assert [one.category for one in found] == ["laptop"]
