"""``omad train proposals`` on the command line."""

from pathlib import Path

import pytest

from helpers.command_line import answer, refused
from omad.model.backbones import get_backbone
from omad.model.checkpoint import load, training_record
from omad.model.proposals.network import ProposalNet

TINY = ["train", "proposals", "--output", "run", "--objects", "1", "--strangers", "3", "--steps", "1", "--batch", "2"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_checkpoint_knows_what_it_was_trained_for(capsys, tmp_path):
    found = answer(capsys, *TINY, "--categories", "laptop", "jar", "laptop", "--device", "cpu")
    assert found == {"checkpoint": "run", "categories": ["laptop", "jar"]}
    assert load(ProposalNet, tmp_path / "run").names == ("laptop", "jar")
    assert training_record(ProposalNet, tmp_path / "run")["features"] == "laptop"
    more = [*TINY, "--categories", "jar", "safe", "--initial", "shipped", "--device", "cpu"]
    assert "another --output" in refused(capsys, *more)
    more[more.index("run")] = "more"
    assert answer(capsys, *more)["categories"] == ["jar", "safe"]


def test_a_finer_look_begins_with_what_a_slim_one_knows(capsys, tmp_path):
    answer(capsys, *TINY, "--categories", "jar", "--size", "fine", "--device", "cpu")
    assert load(ProposalNet, tmp_path / "run").backbone.config == get_backbone("fine")


def test_what_cannot_be_is_refused(capsys):
    assert "submarine" in refused(capsys, *TINY, "--categories", "submarine")
    Path("file").write_text("")
    assert "file: is a file, where a folder" in refused(capsys, *TINY, "--output", "file", "--categories", "submarine")
    assert "nowhere" in refused(capsys, *TINY, "--initial", "nowhere")
    assert "--size huge" in refused(capsys, *TINY, "--size", "huge")
    assert "--features laptop" in refused(capsys, *TINY, "--size", "paper")
    assert "--strangers" in refused(capsys, *TINY[:-6], "--strangers", "0")
