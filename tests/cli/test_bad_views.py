"""Rendered views whose truth or images cannot be, or that do not fit what is asked, are said to be so."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.command_line import LAPTOP, answer, refused
from omad.cli.main import run


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("field", "value"),
    [("axes", [[0, 0, 0]]), ("axes", [[1e-300, 0, 0]]), ("limits", [[1, 0]]), ("part_boxes", [[[1] * 3, [0] * 3]] * 2)],
)
def test_truth_that_cannot_be_is_refused(field, value, capsys):
    made = answer(capsys, "render", *LAPTOP, "--objects", "1", "--views", "1", "--output", "views")
    assert made
    [file] = Path("views").glob("*/object.json")
    file.write_text(json.dumps({**json.loads(file.read_text()), field: value}))
    line = refused(capsys, "eval", "pose", *LAPTOP, "--source", "views")
    assert "object.json" in line
    assert field in line, line


def test_views_that_show_nothing_are_said_to(capsys):
    answer(capsys, "render", *LAPTOP, "--objects", "1", "--views", "1", "--output", "views")
    [depth] = Path("views").glob("*/00000.depth.png")
    Image.fromarray(np.eye(480, 640, dtype=np.uint8) * (np.arange(640) < 9)).save(depth.with_name("00000.mask.png"))
    assert run(["eval", "pose", *LAPTOP, "--source", "views"]) == 1
    assert "1 of 1 views: depth: ... of ... measured pixels" in capsys.readouterr().err
    file = Path("views/dataset.json")
    file.write_text(json.dumps({**json.loads(file.read_text()), "depth_scale": 1.0}))
    assert "m away; depth_scale is in metres" in refused(capsys, "eval", "pose", *LAPTOP, "--source", "views")


def test_rendered_views_that_do_not_fit_the_question(capsys):
    answer(capsys, "render", *LAPTOP, "--objects", "1", "--views", "1", "--output", "views")
    source = ["--source", "views"]
    assert "views of laptop, not of drawer" in refused(capsys, "eval", "pose", "--category", "drawer", *source)
    assert "--depth-noise" in refused(capsys, "eval", "pose", *LAPTOP, *source, "--depth-noise", "on")
    file = Path("views/dataset.json")
    file.write_text(json.dumps({**json.loads(file.read_text()), "category": "drawer"}))  # as of a spec that has changed
    line = refused(capsys, "eval", "pose", "--category", "drawer", *source)
    assert "of 1 joints, where the category has 3" in line
