"""The robustness table against closed forms and against ``omad eval pose`` on the same views."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import omad
from helpers.categories import DRAWER, LAPTOP
from omad.data.procedural import generate
from omad.data.rendering.spoils.spoil import Staging
from omad.data.rendering.standard_views import standard_views
from omad.data.source import ViewSource, load_views
from omad.evaluation.evaluate import evaluate
from omad.evaluation.metrics import missing_errors
from omad.evaluation.robustness.experiment import (
    Measured,
    _measure,
    draw_worst,
    judged,
    measure,
    others,
    scenes_from,
    table,
)
from omad.evaluation.robustness.rows import CLEAN, ROWS

FEW = {name: ROWS[name] for name in (CLEAN, "hidden-25", "wide-3-wall", "aside-4", "around")}


def measured(
    index: int, states: list[float], std: float, flagged: bool = False, wrong: bool = False, seen: Sequence[bool] = ()
) -> Measured:
    errors = replace(missing_errors(LAPTOP), joint_state=np.array(states), missing=False)
    half = std * np.outer([0.6745, 1.645], np.ones(len(states)))
    return Measured(index, errors, half, flagged, wrong, np.array(seen or [True] * len(states)))


def test_the_table_counts_as_it_says() -> None:
    degree = np.radians(1)
    found = {
        CLEAN: [measured(0, [degree], degree), measured(1, [3 * degree], degree), measured(2, [50 * degree], 1.0)],
        "steep": [
            measured(0, [2 * degree], 2 * degree),
            measured(1, [20 * degree], 2 * degree, flagged=True, wrong=True),
        ],
        "below": [measured(0, [12 * degree], 8 * degree, wrong=True)],
        "around": [],
    }
    clean, steep, below = table(found, ROWS, LAPTOP)
    assert clean["ratio"] == pytest.approx(1)
    assert clean["joint_state_error_deg"]["mean"] == pytest.approx(18)
    assert clean["joint_state_error_deg"]["median"] == pytest.approx(3)
    assert clean["joint_state_error"] is None
    assert clean["covered_50"] == pytest.approx(0)
    assert clean["covered_90"] == pytest.approx(2 / 3)  # 3 of one degree is out of 1.645
    assert steep["ratio"] == pytest.approx(22 / 4)  # of the same two views
    assert (steep["flagged"], steep["wrong"], steep["silently_wrong"], steep["views"]) == (0.5, 0.5, 0.0, 2)
    assert steep["trusted"]["ratio"] == pytest.approx(2)
    assert steep["trusted"]["joint_state_error_deg"]["mean"] == pytest.approx(2)
    assert (below["wrong"], below["silently_wrong"], below["covered_90"]) == (1.0, 1.0, 1.0)


def test_the_ratio_is_of_views_that_are_there_when_clean() -> None:
    """An object may be too thin to be seen but from above."""
    found = {CLEAN: [measured(0, [0.1], 0.1)], "steep": [measured(0, [0.2], 0.1), measured(1, [0.9], 0.1)]}
    found |= {"below": [measured(1, [0.9], 0.1)]}
    assert [row["ratio"] for row in table(found, ROWS, LAPTOP)] == [pytest.approx(1), pytest.approx(2), None]


def test_lengths_are_metres_and_missing_answers_are_the_worst() -> None:
    missing = Measured(0, missing_errors(DRAWER), np.full((2, 3), np.nan), True, True, np.zeros(3, bool))
    [row] = table({CLEAN: [missing]}, ROWS, DRAWER)
    assert row["joint_state_error_deg"] is None
    assert row["joint_state_error"]["mean"] == pytest.approx(DRAWER.metres_per_unit)
    assert (row["missing"], row["covered_90"], row["flagged"]) == (1, 0.0, 1.0)
    nothing = {"joint_state_error_deg": None, "joint_state_error": None, "ratio": None}
    assert (row["trusted"], row["seen"]) == (nothing, nothing | {"share": 0.0})


def test_joints_whose_part_shows_stand_alone() -> None:
    """Of three drawers and their clean views: the ratio is of the same joints."""
    clean = measured(0, [0.01, 0.02, 0.03], 0.1)
    hidden = measured(0, [0.02, 0.02, 0.3], 0.1, seen=[True, True, False])
    _, row = table({CLEAN: [clean], "hidden-25": [hidden]}, ROWS, DRAWER)
    assert row["ratio"] == pytest.approx(34 / 6)
    assert row["seen"]["ratio"] == pytest.approx(4 / 3)
    assert row["seen"]["share"] == pytest.approx(2 / 3)
    assert row["seen"]["joint_state_error"] == pytest.approx({"mean": 0.02, "median": 0.02, "p90": 0.02})


def test_probabilities_are_judged_where_there_are_any() -> None:
    plain = measured(0, [0.0], 1.0)
    assert judged([plain]) is None
    told = [replace(plain, probability=0.9), replace(plain, probability=0.2, wrong=True), plain]
    assert judged(told) == pytest.approx({"answers": 2, "right": 0.5, "calibration_error": 0.15, "area_under_roc": 1.0})


@pytest.fixture(scope="module")
def estimator() -> omad.Estimator:
    return omad.Estimator.from_pretrained("laptop", "cpu")


@pytest.fixture(scope="module")
def source() -> ViewSource:
    return load_views("procedural", LAPTOP, 2, 3, 0, "off", "refuse")


def test_a_part_shows_by_its_pixels_in_the_mask(estimator, source) -> None:
    view = next(iter(source.views))
    lidless = replace(view, mask=view.labels == 0)
    assert [each.seen.tolist() for each in _measure(estimator, [view, lidless], to_surface=False)] == [[True], [False]]


def test_clean_views_are_those_of_eval_pose_and_rows_do_not_depend_on_each_other(estimator, source) -> None:
    scenes = scenes_from(source, LAPTOP, 0)
    found = measure(estimator, scenes, 3, FEW)
    models = [generate(LAPTOP, index, "test") for index in range(2)]
    for each, result in zip(found[CLEAN], evaluate(estimator, standard_views(models, LAPTOP, 3)), strict=True):
        assert each.errors.joint_state == pytest.approx(result.refined.joint_state, abs=1e-6)
        # a covariance turns another batch's rounding into per cents where the fit is flat
        intervals = np.array([[joint.interval(level) for joint in result.estimate.joints] for level in (0.5, 0.9)])
        assert 2 * each.half_widths == pytest.approx(np.ptp(intervals, axis=2), rel=0.05)
    alone = measure(estimator, scenes, 3, {name: FEW[name] for name in (CLEAN, "aside-4")})
    for one, other in zip(found["aside-4"], alone["aside-4"], strict=True):
        assert one.errors.joint_state == pytest.approx(other.errors.joint_state, abs=1e-6)
        assert one.flagged == other.flagged
    assert [each.index for each in found["around"]] == [0, 1, 2]


def test_each_scene_is_rendered_once(estimator, source) -> None:
    asked: list[tuple[int, Staging]] = []
    scenes = scenes_from(source, LAPTOP, 0)

    def counted(index: int, staging: Staging):
        asked.append((index, staging))
        return scenes(index, staging)

    measure(estimator, counted, 2, FEW)
    assert len(asked) == len(set(asked)) == 2 * len({row.spoil.staging for row in FEW.values()})


def test_answers_go_on_towards_their_surfaces_as_evaluated(estimator, source) -> None:
    found = measure(estimator, scenes_from(source, LAPTOP, 0), 2, {CLEAN: ROWS[CLEAN]}, to_surface=True)
    models = [generate(LAPTOP, index, "test") for index in range(2)]
    expected = evaluate(estimator, standard_views(models, LAPTOP, 2), to_surface=True)
    for each, result in zip(found[CLEAN], expected, strict=True):
        assert each.errors.joint_state == pytest.approx(result.refined.joint_state, abs=1e-6)
    before = measure(estimator, scenes_from(source, LAPTOP, 0), 2, {CLEAN: ROWS[CLEAN]})
    assert all(
        (a.errors.joint_state != b.errors.joint_state).all() for a, b in zip(found[CLEAN], before[CLEAN], strict=True)
    )


def test_images_are_spoilt_as_models_are_but_not_seen_from_elsewhere(estimator, source, tmp_path: Path) -> None:
    images = replace(source, views=list(standard_views(source.models, LAPTOP, 3)), models=())
    scenes = scenes_from(images, LAPTOP, 0)
    found = measure(estimator, scenes, 3, FEW)
    assert {name: len(each) for name, each in found.items()} == dict.fromkeys(FEW, 3) | {"around": 0}
    rendered = measure(estimator, scenes_from(source, LAPTOP, 0), 3, {CLEAN: ROWS[CLEAN]})
    for one, other in zip(found[CLEAN], rendered[CLEAN], strict=True):
        assert one.errors.joint_state == pytest.approx(other.errors.joint_state, abs=1e-6)
    paths = draw_worst(estimator, scenes, found, FEW, tmp_path)
    assert {Path(path).stem for path in paths} == {name for name in FEW if name != "around"}
    assert all(Path(path).stat().st_size > 10_000 for path in paths)


@pytest.mark.parametrize(
    ("total", "count", "taken"), [(10, 7, [0, 1, 2, 4, 5, 7, 8]), (9, 3, [0, 3, 6]), (3, 5, [0, 1, 2]), (0, 5, [])]
)
def test_some_images_are_taken_evenly_from_all_and_no_more_are_read(total, count, taken) -> None:
    left = iter(range(total))
    source = ViewSource(left, total, noisy=False).spread(count)  # pyright: ignore[reportArgumentType]
    assert (list(source.views), source.total) == (taken, len(taken))
    assert next(left, total) == (taken[-1] + 1 if taken else total)


def test_every_row_says_what_it_is_and_no_two_are_alike() -> None:
    assert all(row.what for row in ROWS.values())
    assert len({row.spoil for row in ROWS.values()}) == len(ROWS)


def test_no_answer_to_another_categorys_object_is_right(estimator) -> None:
    found = others(estimator, 4, 0)
    assert [each.index for each in found] == [0, 1, 2, 3]
    assert all(each.wrong for each in found)
    assert [each.flagged for each in others(estimator, 2, 0)] == [each.flagged for each in found[:2]]
