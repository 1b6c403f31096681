"""Rendered views whose truth or images cannot be, or that do not fit what is asked, are said to be so."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.command_line import LAPTOP, answer, refused
from omad.cli.main import run
from omad.cli.options import Views
from omad.objects.category_file import get_category


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


OWN = """
from dataclasses import replace
from omad.data.procedural.handheld.laptop import generate as usual

def generate(rng, category, unusual):
    made = usual(rng, category, unusual)
    if rng.random() < 0.2:
        parts = tuple(part.warped(lambda vertices: vertices * {factor}) for part in made.parts)
        made = replace(made, parts=parts, pivots=made.pivots * {factor})
    return made
"""


def test_views_of_a_generator_that_changed_are_others():
    """Though the first of them are the same."""

    def told(factor):
        Path("own.py").write_text(OWN.format(factor=factor))
        views = Views(source="own.py", objects=12, views=12)
        return views.identity(views.load(get_category("laptop")))

    assert told(1.0) == told(1.0) != told(1.5)


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (["eval", "pose", "--views", "1", "--output", "errors"], "--output"),
        (["eval", "pose", "--views", "1", "--workers", "2"], "--workers"),
        (["eval", "pose", "--views", "1", "--shard", "2"], "--shard"),
        (["render", "--output", "views", "--shard", "2"], "--shard"),
        (["bulk", "stack.npy", "--intrinsics", "600,600,320,240", "--output", "out.jsonl", "--shard", "2"], "--shard"),
    ],
)
def test_what_goes_with_shards_alone_is_not_ignored(command, option, capsys):
    np.save("stack.npy", np.ones((1, 48, 64), np.float32))
    assert f"{option}: goes with --cluster" in refused(capsys, *command, *LAPTOP)
    assert not any(map(Path.exists, map(Path, ("errors", "views", "out.jsonl"))))
