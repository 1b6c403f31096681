"""``omad train all``: one command from nothing to measured weights, which goes on where it was."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from helpers.command_line import answer, refused
from omad.cli.main import run
from omad.cli.training.networks import SeveralProcesses
from omad.evaluation.confidence import fitting
from omad.model.checkpoint import load, training_record
from omad.model.omadnet import OmadNet
from omad.training import loop
from omad.training.processes import Processes

TINY = ["--objects", "2", "--views", "2", "--steps", "2", "--batch", "2", "--device", "cpu", "--output", "runs"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_all_steps_of_two_categories_and_what_is_done_stays(capsys, monkeypatch):
    monkeypatch.setattr(fitting, "FEWEST", 5)
    monkeypatch.setattr(fitting, "STEPS", 5)
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
        assert (record["initial"]["schedule"]["seed"], record["schedule"]["seed"]) == (0, 1)  # other views
        assert record["initial"]["features"]["category"] == "laptop"
    monkeypatch.setattr(loop, "train", None)  # nothing is trained again
    Path("runs/laptop/results.json").unlink()
    again = answer(capsys, *command)
    for one, other in zip(found["results"], again["results"], strict=True):
        assert one["refined"] == other["refined"]
    assert run(command[:-1] + ["runs"]) == 0
    seen = capsys.readouterr()
    assert "within 5° 5 %" in seen.out
    assert "laptop: bank of surfaces is done, and kept" in seen.err
    line = refused(capsys, *command, "--seed", "3", "--views", "4")
    assert "runs/laptop: belongs to a training with --views 2 (here 4), --seed 0 (here 3)" in line


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("lightning_fabric") is None, reason="needs Fabric (omad[cluster])")
def test_two_processes_share_the_networks_training_and_one_does_the_rest(tmp_path):
    """As a script of its own, which the second process runs, too."""
    script = tmp_path / "small.py"
    script.write_text(
        "from omad.evaluation.confidence import fitting\nfrom omad.__main__ import main\n"
        "fitting.FEWEST = fitting.STEPS = 5\nif __name__ == '__main__':\n    main()\n"
    )
    command = [
        "train",
        "all",
        "--categories",
        "laptop",
        "scissors",
        *TINY,
        "--devices",
        "2",
        "--accumulate",
        "1",
        "--json",
    ]
    done = subprocess.run([sys.executable, str(script), *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    found = json.loads(done.stdout)  # one object, whatever number of processes
    assert [result["category"] for result in found["results"]] == ["laptop", "scissors"]
    for name in ("laptop", "scissors"):
        assert done.stderr.count(f"{name}: network") == 2
        assert done.stderr.count(f"{name}: confidence") == 1
        folder = Path("runs") / name
        for file in ("config.json", "confidence.json", "surfaces.npz", "results.json"):
            assert (folder / file).is_file(), file
        for stage, others in ((folder / "first", 1), (folder, 1), (folder / "prior", 0)):
            assert len(torch.load(stage / "state.pt", weights_only=True)["generators"]) == others


def test_a_batch_that_cannot_be_shared_is_refused_before_anything_is_trained(capsys, monkeypatch):
    monkeypatch.setattr(SeveralProcesses, "start", lambda self: Processes(torch.device("cpu"), count=3))
    assert "--batch 2: cannot be dealt out evenly to 3 processes" in refused(capsys, "train", "all", *TINY)
    assert not Path("runs").exists()


def test_features_that_are_not_there_are_refused_before_anything_is_trained(capsys):
    assert "no weights for 'laptp' (laptop?)" in refused(capsys, "train", "all", *TINY, "--features", "laptp")
    assert not Path("runs").exists()


def test_what_cannot_be_generated_is_refused(capsys):
    line = refused(capsys, "train", "all", "--categories", "submarine", *TINY)
    assert "submarine" in line
    assert "laptop" in line
