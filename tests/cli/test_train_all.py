"""``omad train all``: one command from nothing to measured weights, which goes on where it was."""

from pathlib import Path

import pytest

from helpers.command_line import answer, refused
from omad.cli.main import run
from omad.evaluation.confidence import fitting
from omad.model.checkpoint import load, training_record
from omad.model.omadnet import OmadNet
from omad.training import loop

TINY = ["--objects", "2", "--views", "2", "--steps", "2", "--batch", "2", "--device", "cpu", "--output", "runs"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_all_steps_of_two_categories_and_what_is_done_stays(capsys, monkeypatch):
    monkeypatch.setattr(fitting, "FEWEST", 5)
    command = ["train", "all", "--categories", "laptop", "dishwasher", *TINY]
    found = answer(capsys, *command)
    assert [result["category"] for result in found["results"]] == ["laptop", "dishwasher"]
    assert all(result["views"] == 2 for result in found["results"])
    for name in ("laptop", "dishwasher"):
        folder = Path("runs") / name
        for file in ("prior/config.json", "config.json", "confidence.json", "surfaces.npz"):
            assert (folder / file).is_file(), file
        net, record = load(OmadNet, folder), training_record(OmadNet, folder)
        assert net.tells_outside
        assert record["refinement_loss"] == 6.0
        assert record["initial"]["features"]["category"] == "laptop"
    monkeypatch.setattr(loop, "train", None)  # nothing is trained again
    Path("runs/laptop/results.json").unlink()
    again = answer(capsys, *command)
    for one, other in zip(found["results"], again["results"], strict=True):
        assert one["refined"] == other["refined"]
    assert run(command[:-1] + ["runs"]) == 0
    assert "within 5° 5 %" in capsys.readouterr().out


def test_what_cannot_be_generated_is_refused(capsys):
    line = refused(capsys, "train", "all", "--categories", "submarine", *TINY)
    assert "submarine" in line
    assert "laptop" in line
