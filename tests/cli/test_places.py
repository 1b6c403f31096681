"""Where answers are put, and where weights are looked for."""

from pathlib import Path

import pytest

from helpers.command_line import refused
from omad.cli.estimate import _folder_names
from omad.model.checkpoint import WEIGHTS


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("names", [("...png", "x.png"), ("..png", "x.png"), ("A.png", "a.png")], ids=str)
def test_every_answer_has_a_folder_of_its_own_in_the_output(names):
    found = _folder_names([Path("in") / name for name in names])
    assert len({name.casefold() for name in found}) == len(names)
    assert all(Path("out", name).resolve().parent == Path("out").resolve() for name in found)


def test_of_a_folder_of_checkpoints_it_is_said_that_one_is_to_be_given(capsys):
    for name in ("laptop", "stapler"):
        Path("own", name).mkdir(parents=True)
        Path("own", name, "config.json").touch()
    line = refused(capsys, "estimate", "x.png", "--category", "auto", "--weights", "own", "--intrinsics", "9,9,4,4")
    assert "own: no config.json here; give one of the folders in it" in line


def test_two_checkpoints_of_one_category_are_not_mixed(capsys):
    Path("own").mkdir()
    for name in ("first", "second"):
        Path("own", name).symlink_to(WEIGHTS / "laptop")
    assert "--category: names nothing" in refused(capsys, "figure", "keypoints", "--category")
    for command in ("figure keypoints", "figure sweep"):
        line = refused(capsys, *command.split(), "--weights", "own")
        assert "own: first and second are both for laptop; leave one of them out" in line
