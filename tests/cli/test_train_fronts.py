"""``omad train fronts`` on the command line."""

import pytest

from helpers.command_line import answer, refused
from omad.model.checkpoint import load, training_record
from omad.model.fronts.hands import HandNet
from omad.model.fronts.network import FrontNet

TINY = ["train", "fronts", "--output", "run", "--objects", "2", "--views", "4", "--steps", "1", "--batch", "2"]
TINY += ["--device", "cpu", "--categories", "drawer_1", "jar"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_checkpoint_knows_what_it_was_trained_for_and_images_are_kept(capsys, tmp_path):
    assert answer(capsys, *TINY) == {"checkpoint": "run", "categories": ["drawer_1", "jar"], "hands": []}
    assert load(FrontNet, tmp_path / "run").names == ("drawer_1", "jar")
    assert training_record(FrontNet, tmp_path / "run")["views"] == 4
    kept = tmp_path / "run" / "images" / "jar.npz"
    made = kept.stat().st_mtime_ns
    answer(capsys, *TINY)
    assert kept.stat().st_mtime_ns == made
    assert "made with other views; delete it, or give another --output" in refused(capsys, *TINY, "--views", "5")


def test_where_objects_may_be_of_either_hand_that_is_learned_too(capsys, tmp_path):
    assert answer(capsys, *TINY[:-2], "safe", "jar")["hands"] == ["safe"]
    assert load(HandNet, tmp_path / "run" / "hands").names == ("safe",)


def test_what_cannot_be_is_refused(capsys):
    assert "submarine" in refused(capsys, *TINY[:-2], "submarine")
    assert "x.png: is the name of a file" in refused(capsys, *TINY[:-2], "submarine", "--output", "x.png")
    assert "--views" in refused(capsys, *TINY, "--views", "0")
