"""Table 1: its IoU is right, its cache is honest, A-NCSH is left out where it has no weights."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from helpers.categories import DRAWER, LAPTOP, SCISSORS
from helpers.command_line import answer, refused
from omad.cli.main import run
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view, true_pose
from omad.data.source import ViewSource
from omad.evaluation.baselines.ancsh.net import AncshNet
from omad.evaluation.paper import table1
from omad.evaluation.paper.box_iou import box_iou
from omad.evaluation.paper.predictions import Predictions, Predictor, Truths, predict
from omad.evaluation.paper.published import TABLE1
from omad.model.backbones.pointnet2 import PointNet2Config
from omad.model.checkpoint import WEIGHTS, save
from omad.objects.category_file import get_category
from omad.objects.pose import ObjectPose

TABLE = ["eval", "table1", "--categories", "laptop", "--objects", "2", "--views", "4"]
TINY = PointNet2Config(points=128, centres=(32, 16), neighbours=(8, 8), widths=(24, 32, 48), dense=32)


def test_iou_of_boxes():
    boxes = np.array([[[0.0, 0, 0], [2, 2, 2]]])
    still, moved, apart = np.tile(np.eye(4), (3, 1, 1, 1))
    moved[:, 0, 3], apart[:, 1, 3] = 1.0, 5.0
    assert box_iou(still, still, boxes) == pytest.approx(1)
    assert box_iou(moved, still, boxes) == pytest.approx(1 / 3)
    assert box_iou(apart, still, boxes) == 0
    turned = still.copy()
    turned[:, :2, :2] = [[np.cos(np.pi / 4), -np.sin(np.pi / 4)], [np.sin(np.pi / 4), np.cos(np.pi / 4)]]
    centred = np.array([[[-1.0, -1, -1], [1, 1, 1]]])
    octagon = 8 * (np.sqrt(2) - 1)  # area shared by a square of side 2 and itself turned by 45 degrees
    assert box_iou(turned, still, centred) == pytest.approx(octagon / (8 - octagon), abs=0.03)
    assert box_iou(np.full((1, 4, 4), np.nan), still, boxes) == 0


def test_paper_has_a_row_for_every_method():
    for lines in TABLE1.values():
        assert set(lines) == {"ancsh", "omad_initial", "omad_refined"}


@pytest.fixture
def weights(tmp_path, monkeypatch) -> Path:
    """The shipped laptop, with an A-NCSH that has learned nothing."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(WEIGHTS / "laptop", "weights/laptop", ignore=shutil.ignore_patterns("prior", "ancsh"))
    torch.manual_seed(0)
    save(AncshNet(LAPTOP, TINY), Path("weights/laptop/ancsh"), {})
    return Path("weights")


@pytest.mark.slow
def test_all_methods_on_the_same_views_and_again_from_the_cache(weights, capsys, monkeypatch):
    found = answer(capsys, *TABLE, "--weights", "weights")
    assert [row["method"] for row in found["rows"]] == ["ancsh", "omad_initial", "omad_refined"]
    for row in found["rows"]:
        assert len(row["joint_state"]) == len(row["axis_distance"]) == 1
        assert len(row["rotation_error_deg"]) == len(row["translation_error"]) == len(row["iou"]) == 2
        assert row["seconds"]["total"] > 0
        assert row["paper"]["seconds"] > 0
    ancsh, initial, refined = found["rows"]
    assert refined["joint_state"][0] < initial["joint_state"][0] < ancsh["joint_state"][0]
    assert min(refined["iou"]) > max(ancsh["iou"])
    compared = found["comparison"]["laptop"]
    assert compared["ahead_on_joint_state"] is True
    assert compared["alignment_over_refinement"] > 1
    assert found["left_out"] == []

    monkeypatch.setattr("omad.evaluation.paper.predictions.predict", None)  # nothing is predicted again
    assert answer(capsys, *TABLE, "--weights", "weights") == found
    assert run([*TABLE, "--weights", "weights"]) == 0
    assert "laptop" in capsys.readouterr().out


@pytest.mark.slow
def test_a_cache_of_other_weights_or_data_is_refused(weights, capsys):
    table = [*TABLE, "--weights", "weights", "--cache", "predictions"]
    answer(capsys, *table)
    assert "predictions" in refused(capsys, *table, "--seed", "1")
    save(AncshNet(LAPTOP, TINY), weights / "laptop" / "ancsh", {})
    assert "ancsh.npz: " in refused(capsys, *table)
    Path("predictions/laptop/ancsh.npz").write_bytes(b"nonsense")
    assert "ancsh.npz: " in refused(capsys, *table)


@pytest.mark.slow
def test_without_a_folder_predictions_go_to_the_users_cache(weights, capsys, monkeypatch):
    monkeypatch.setenv("OMAD_CACHE", str(Path("own").absolute()))
    before = {path.name for path in Path().iterdir()}
    found = answer(capsys, *TABLE, "--weights", "weights")
    assert {path.name for path in Path().iterdir()} - before == {"own"}
    assert len(list(Path("own/predictions").glob("laptop-*.npz"))) == 3
    assert answer(capsys, *TABLE, "--weights", "weights", "--seed", "1")["rows"] != found["rows"]  # not refused
    assert answer(capsys, *TABLE, "--weights", "weights") == found


def test_without_weights_the_baseline_is_left_out(weights, capsys):
    shutil.rmtree("weights/laptop/ancsh")
    found = answer(capsys, *TABLE, "--weights", "weights")
    assert [row["method"] for row in found["rows"]] == ["omad_initial", "omad_refined"]
    assert found["comparison"] == {"laptop": None}
    assert [entry["method"] for entry in found["left_out"]] == ["ancsh"]
    assert json.dumps(found)
    assert "weights/spoon" in refused(capsys, *TABLE[:2], "--categories", "spoon", "--weights", "weights")


def test_a_source_without_a_view_is_named():
    with pytest.raises(InputError, match="laptop: there is no view"):
        predict(ViewSource([], 0, noisy=False), get_category("laptop"), {})


def only(category, found, true):
    boxes = np.tile([[[0.0, 0, 0], [1, 2, 3]]], (len(category.parts), 1, 1))
    truths = Truths(np.array(["a"]), boxes[None], ObjectPose.stack([true]))
    stacked = ObjectPose.stack([found])
    return table1.row("omad", truths, Predictions(stacked, stacked, np.ones((1, 3)), ""), category)


@pytest.mark.parametrize("category", [LAPTOP, DRAWER], ids=lambda category: category.name)
def test_lengths_are_in_category_units(category):
    unit, joints, parts = category.metres_per_unit, len(category.joints), len(category.parts)
    axes, T = np.tile([0.0, 0, 1], (joints, 1)), np.tile(np.eye(4), (parts, 1, 1))
    true, there = ObjectPose(np.zeros(joints), axes, np.zeros((joints, 3)), T), T.copy()
    there[:, 0, 3] = 0.2 * unit
    moved = {"states": true.states + 0.1 * unit, "pivots": true.pivots + [0.3 * unit, 0, 0]}
    off = replace(true, **moved, T_camera_part=there)
    found = only(category, off, true)
    assert found["translation_error"] == pytest.approx([0.2] * parts)
    if category is LAPTOP:
        assert found["pivot_distance"] == found["axis_distance"] == pytest.approx([0.3])
    else:
        assert found["joint_state"] == pytest.approx([0.1] * joints)


def test_either_labelling_of_scissors_overlaps():
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, :2, :2] = [[0, -1], [1, 0]]
    true = ObjectPose(np.array([np.pi / 2]), np.array([[0.0, 0, 1]]), np.zeros((1, 3)), T)
    assert only(SCISSORS, true.swapped(), true)["iou"] == pytest.approx([1, 1], abs=1e-6)


def test_times_are_of_the_steps_that_took_them():
    view = standard_view(generate(LAPTOP, 0, "test"), LAPTOP, (0, 0, 0))
    pose = true_pose(view, LAPTOP)
    answer = SimpleNamespace(initial_pose=lambda: pose, pose=lambda: pose, seconds={"network": 1.0, "refinement": 2.0})
    made = predict(ViewSource([view], 1, noisy=False), LAPTOP, {"it": Predictor(lambda seen: answer, {})})
    assert made["it"]["seconds"][0, :2].tolist() == [1.0, 2.0]
