"""Training loses nothing to signals, kills and full disks, and goes on with nothing but what it began with."""

import json
import os
import signal
import threading
from dataclasses import replace

import pytest
import torch
from torch import nn

from helpers.categories import LAPTOP
from omad.common import files
from omad.common.errors import InputError, WorkError
from omad.common.processes.locks import only_one
from omad.data.procedural import generate
from omad.model.checkpoint import load
from omad.model.priornet import PriorNet
from omad.training.loop import Schedule, train
from omad.training.train_prior import PriorTraining, train_prior

SCHEDULE = Schedule(steps=40, batch=8, log_steps=10)


class Line(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(2, 1)


def fresh() -> Line:
    torch.manual_seed(0)
    return Line()


def terms(model, generator):
    x = torch.randn(8, 2, generator=generator)
    return {"fit": (model.layer(x) - x.sum(1, keepdim=True)).square().mean()}


def signalled(number: int, at: int):
    """The loss, which sends this process a signal at its step ``at``, half way through."""
    count = []

    def drawn(model, generator):
        found = terms(model, generator)
        count.append(1)
        if len(count) == at:
            signal.raise_signal(number)
        return found

    return drawn


@pytest.fixture(autouse=True)
def handlers():
    """SIGTERM as the command line has it; what a test leaves is put back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_training_goes_on_with_the_next_step(number, tmp_path, capsys):
    """It is saved on the way out, long before the interval is over."""
    kept = train(fresh(), terms, SCHEDULE, tmp_path / "whole", {})
    with pytest.raises(KeyboardInterrupt):
        train(fresh(), signalled(number, 25), SCHEDULE, tmp_path / "stopped", {})
    assert torch.load(tmp_path / "stopped/state.pt", weights_only=True)["step"] == 25
    with pytest.raises(InputError, match="stopped: its training was interrupted; give the same command again"):
        load(PriorNet, tmp_path / "stopped")
    counted = []
    resumed = train(fresh(), lambda m, g: counted.append(1) or terms(m, g), SCHEDULE, tmp_path / "stopped", {})
    assert len(counted) == SCHEDULE.steps - 25
    assert torch.equal(resumed.layer.weight, kept.layer.weight)
    assert "stopped: the training goes on, after 25 steps" in capsys.readouterr().err
    train(fresh(), terms, SCHEDULE, tmp_path / "stopped", {})
    assert "stopped: the training has ended before, after 40 steps" in capsys.readouterr().err


def test_the_interval_is_no_part_of_what_is_trained(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        train(fresh(), signalled(signal.SIGINT, 5), SCHEDULE, tmp_path, {"settings": {"schedule": {"save_seconds": 9}}})
    other = replace(SCHEDULE, save_seconds=0.5, log_steps=5)
    train(fresh(), terms, other, tmp_path, {"settings": {"schedule": {"save_seconds": 7}}})


def test_one_folder_is_for_one_training(tmp_path):
    with only_one(tmp_path, "a training"), pytest.raises(InputError, match=r"writing here already"):
        train(fresh(), terms, SCHEDULE, tmp_path, {})
    train(fresh(), terms, SCHEDULE, tmp_path, {})
    assert not [path.name for path in tmp_path.iterdir() if "lock" in path.name]


def test_in_another_thread_it_trains_as_well(tmp_path):
    found = []
    thread = threading.Thread(target=lambda: found.append(train(fresh(), terms, SCHEDULE, tmp_path, {})))
    thread.start()
    thread.join()
    assert len(found) == 1


def test_a_full_disk_leaves_the_state_that_was_there(tmp_path, monkeypatch):
    train(fresh(), terms, SCHEDULE, tmp_path, {})
    before = (tmp_path / "state.pt").read_bytes()

    def full(temporary, path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "publish", full)
    with pytest.raises(WorkError, match="No space left"):
        train(fresh(), terms, SCHEDULE, tmp_path, {})
    assert (tmp_path / "state.pt").read_bytes() == before
    assert not list(tmp_path.glob(".omad-*"))


def test_weights_that_are_not_finite_are_not_saved(tmp_path):
    def spoilt(model, generator):
        found = terms(model, generator)
        return found if len(seen := steps) < 13 and not seen.append(1) else {"fit": found["fit"] * torch.inf}

    steps: list[int] = []
    schedule = replace(SCHEDULE, steps=14, log_steps=100)
    with pytest.raises(WorkError, match="not finite at step 14; lower the learning rate"):
        train(fresh(), spoilt, schedule, tmp_path, {})
    assert not (tmp_path / "state.pt").exists()


def test_what_a_killed_training_left_unfinished_goes(tmp_path):
    files._sweep.cache_clear()
    (tmp_path / ".omad-1234.pt").write_bytes(b"half a state")
    (tmp_path / ".mine").write_text("stays")
    train(fresh(), terms, SCHEDULE, tmp_path, {})
    assert not list(tmp_path.glob(".omad-*"))
    assert (tmp_path / ".mine").exists()


def test_what_is_being_written_stays(tmp_path):
    with files.unfinished(tmp_path / "one.txt") as temporary:
        files._sweep.cache_clear()
        files.write_text(tmp_path / "two.txt", "")
        assert temporary.exists()


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04"])
def test_a_broken_state_is_named(content, tmp_path):
    (tmp_path / "state.pt").write_bytes(content)
    with pytest.raises(InputError, match=r"state\.pt: .*--output"):
        train(fresh(), terms, SCHEDULE, tmp_path, {})


def test_a_metrics_file_of_anything_is_gone_on_with(tmp_path):
    (tmp_path / "metrics.jsonl").write_bytes(b'[1]\n{"step": null}\n\xff\n{"step": 1}\n' + b"[" * 5000)
    train(fresh(), terms, SCHEDULE, tmp_path, {})
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [10, 20, 30, 40]


@pytest.mark.parametrize("changed", ["surfaces", "networks"])
def test_a_training_is_not_resumed_with_other_files_of_the_same_name(changed, tmp_path):
    models = [generate(LAPTOP, index) for index in range(2)]
    torch.manual_seed(1)
    initial = PriorNet(LAPTOP)
    settings = PriorTraining(schedule=Schedule(steps=2, batch=2), points=128)
    train_prior(models, LAPTOP, tmp_path, settings, initial=initial)
    if changed == "surfaces":
        models[1] = replace(generate(LAPTOP, 7), name=models[1].name)
    else:
        initial = PriorNet(LAPTOP)
    with pytest.raises(InputError, match=rf"state\.pt: .*{changed}"):
        train_prior(models, LAPTOP, tmp_path, settings, initial=initial)


@pytest.mark.skipif(os.name == "nt", reason="signals as POSIX has them")
def test_a_second_signal_is_not_waited_for(tmp_path):
    def twice(model, generator):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        return terms(model, generator)

    with pytest.raises(KeyboardInterrupt):
        train(fresh(), twice, SCHEDULE, tmp_path, {})
    assert not (tmp_path / "state.pt").exists()
