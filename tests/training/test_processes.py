"""A training by several processes: it is the training of one, it survives what happens to one of them."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from helpers import line_training
from helpers.command_line import answer
from helpers.line_training import BATCH, drawn, fresh, schedule, terms, train_line
from omad.common.errors import InputError
from omad.model.backbones.pointnet2 import PointNet2Config
from omad.training.loop import train
from omad.training.processes import ALONE, Processes, start

MISSING = importlib.util.find_spec("lightning_fabric") is None


def together(test):
    """Of several processes, each of which takes some seconds to begin."""
    skip = pytest.mark.skipif(MISSING, reason="Lightning Fabric is not installed (omad[cluster])")
    return pytest.mark.slow(skip(test))


CPU = torch.device("cpu")


def begin(folder: Path, devices: int, steps: int, save_seconds: float = 60.0, pause: float = 0.0) -> subprocess.Popen:
    words = [sys.executable, line_training.__file__, folder, devices, steps, save_seconds, pause]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.Popen([*map(str, words)], stderr=subprocess.PIPE, text=True, env=environment)


def run(*arguments: object) -> None:
    process = begin(*arguments)  # pyright: ignore
    _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said


@pytest.fixture(scope="module")
def of_two(tmp_path_factory) -> Path:
    """A training of two processes on this machine."""
    folder = tmp_path_factory.mktemp("training") / "two"
    run(folder, 2, 20)
    return folder


@pytest.fixture(scope="module")
def stopped(tmp_path_factory) -> Path:
    """The same, terminated after some steps."""
    folder = tmp_path_factory.mktemp("training") / "stopped"
    process = begin(folder, 2, 20, 60.0, 0.2)
    wait_for(lambda: (folder / "metrics.jsonl").exists() and len(rows(folder)) > 5)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 143
    assert 5 < step_of(folder) < 20
    return folder


def rows(folder: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]


def step_of(folder: Path) -> int:
    return torch.load(folder / "state.pt", weights_only=True)["step"]


def wait_for(what, seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "it does not come"
        time.sleep(0.05)


def children(process: subprocess.Popen) -> list[int]:
    found = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
    return [int(word) for word in found.split()]


def test_a_batch_is_dealt_out_evenly_or_not_at_all():
    assert Processes(CPU, parts=2, count=3).share(12) == 2
    with pytest.raises(InputError, match=r"--batch 10: .*3 processes"):
        Processes(CPU, count=3).share(10)


def test_processes_draw_from_streams_of_their_own_and_one_alone_as_it_always_did():
    first, second, later = (
        drawn(4, Processes(CPU, rank=rank, count=2).generator(7, CPU, step)) for rank, step in ((0, 0), (1, 0), (1, 5))
    )
    torch.testing.assert_close(first, drawn(4, torch.Generator().manual_seed(7)), rtol=0, atol=0)
    assert not torch.isclose(first, second).any()
    assert not torch.isclose(second, later).any()


def test_parts_of_a_batch_give_the_step_of_the_whole(tmp_path):
    """Three parts of four samples each, one after the other, are the twelve that one part has."""
    whole = train_line(tmp_path / "whole", ALONE, 10)
    parts = train_line(tmp_path / "parts", replace(ALONE, parts=3), 10)
    torch.testing.assert_close(parts.layer.weight, whole.layer.weight, rtol=1e-5, atol=1e-7)


def test_half_precision_is_the_backbones_alone():
    backbone = PointNet2Config().build()
    cloud = torch.randn(2, 512, 3, generator=torch.Generator().manual_seed(0))
    plain = backbone(cloud)
    replace(ALONE, precision="bf16").shorten(backbone)
    found = backbone(cloud)
    assert (found.dense.dtype, found.pooled.dtype) == (torch.float32, torch.float32)
    assert not torch.equal(found.pooled, plain.pooled)
    assert torch.equal(backbone.pooled(cloud), found.pooled)
    off = (found.pooled - plain.pooled).norm() / plain.pooled.norm()
    assert off < 0.02  # eight bits of each number, and neighbours that are the same
    with pytest.raises(InputError, match="--precision bf16"):
        start(1, 1, 1, "cpu", "bf16")


def test_without_fabric_the_cure_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "lightning_fabric", None)
    with pytest.raises(InputError, match=r"omad\[cluster\]"):
        start(2, 1, 1, "cpu", "float32")


@together
def test_two_processes_take_the_steps_that_one_takes_with_both_of_their_samples(of_two, tmp_path):
    other = Processes(CPU, rank=1, count=2).generator(0, CPU)

    def both(model, generator):
        return terms(model, torch.cat([drawn(BATCH // 2, generator), drawn(BATCH // 2, other)]))

    one = train(fresh(), both, schedule(20), tmp_path / "one", {})
    two = torch.load(of_two / "kept.pt", weights_only=True)
    torch.testing.assert_close(two["layer.weight"], one.layer.weight, rtol=1e-5, atol=1e-7)
    torch.testing.assert_close(two["layer.bias"], one.layer.bias, rtol=1e-5, atol=1e-7)
    curves = [[row["fit"] for row in rows(folder)] for folder in (tmp_path / "one", of_two)]
    assert curves[1] == pytest.approx(curves[0], rel=1e-5)
    assert sorted(path.name for path in of_two.iterdir() if "tfevents" not in path.name) == [
        "kept.pt", "metrics.jsonl", "state.pt",
    ]  # fmt: skip


@together
def test_terminated_they_end_after_the_same_step_and_go_on_exactly(of_two, stopped, tmp_path):
    shutil.copytree(stopped, tmp_path / "stopped")
    run(tmp_path / "stopped", 2, 20)
    whole, resumed = (torch.load(folder / "kept.pt", weights_only=True) for folder in (of_two, tmp_path / "stopped"))
    assert torch.equal(whole["layer.weight"], resumed["layer.weight"])


@together
@pytest.mark.parametrize("others", [1, 3])
def test_another_number_of_processes_goes_on(others, stopped, tmp_path):
    shutil.copytree(stopped, tmp_path, dirs_exist_ok=True)
    done = step_of(tmp_path)
    before = rows(tmp_path)[:done]
    if others == 1:
        train_line(tmp_path, ALONE, 20)
    else:
        run(tmp_path, others, 20)
    assert [row["step"] for row in rows(tmp_path)] == list(range(1, 21))
    assert rows(tmp_path)[:done] == before
    assert step_of(tmp_path) == 20


@together
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds child processes as Linux tells of them")
@pytest.mark.parametrize("killed", ["the first", "another"])
def test_where_one_is_killed_all_end_and_little_is_lost(killed, tmp_path):
    interval, pause = 0.5, 0.02
    process = begin(tmp_path, 2, 100_000, interval, pause)
    wait_for(lambda: (tmp_path / "state.pt").exists() and rows(tmp_path)[-1]["seconds"] > 3 * interval)
    [other] = children(process)
    os.kill(process.pid if killed == "the first" else other, signal.SIGKILL)
    _, said = process.communicate(timeout=60)
    wait_for(lambda: not Path(f"/proc/{other}").exists(), 60)
    assert process.returncode != 0
    if killed == "another":
        assert said.count("another process of this training ended") == 1  # PyTorch may speak of the connection, too
        assert "Traceback" not in said
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    lost = rows(tmp_path)[-1]["seconds"] - state["seconds"]
    # a step more, as it is saved after the one in which the time has come, and what writing takes on a busy machine
    assert lost < interval + 20 * pause
    if killed == "another":
        return
    again = begin(tmp_path, 2, 100_000, interval, pause)
    wait_for(lambda: step_of(tmp_path) > state["step"])
    again.send_signal(signal.SIGTERM)
    again.communicate(timeout=60)
    assert [row["step"] for row in rows(tmp_path)] == list(range(1, step_of(tmp_path) + 1))


def test_a_state_of_other_settings_is_refused_once(tmp_path):
    train_line(tmp_path, ALONE, 5)
    with pytest.raises(InputError, match=r"state\.pt: "):
        train_line(tmp_path, ALONE, 6)


def launched(folder: Path, launcher: str, node: int) -> subprocess.Popen:
    """One of two machines, with one process."""
    words = [line_training.__file__, folder, "1x2", 20]
    if launcher == "torchrun":
        where = ["--master-addr", "127.0.0.1", "--master-port", "29541"]
        words = [
            "-m",
            "torch.distributed.run",
            "--nnodes",
            2,
            "--nproc-per-node",
            1,
            "--node-rank",
            node,
            *where,
            *words,
        ]
        told = {}
    else:  # what srun tells of itself
        told = {"SLURM_NTASKS": 2, "SLURM_NTASKS_PER_NODE": 1, "SLURM_JOB_NAME": "train", "SLURM_JOB_ID": 29542}
        told |= {"SLURM_PROCID": node, "SLURM_LOCALID": 0, "SLURM_NODEID": node, "SLURM_NODELIST": "127.0.0.1"}
        told |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": 29542}
    environment = os.environ | {"OMP_NUM_THREADS": "1"} | {name: str(value) for name, value in told.items()}
    return subprocess.Popen([sys.executable, *map(str, words)], stderr=subprocess.PIPE, text=True, env=environment)


@together
@pytest.mark.parametrize("launcher", ["torchrun", "SLURM"])
def test_two_machines_are_started_by_a_launcher(launcher, of_two, tmp_path):
    machines = [launched(tmp_path / "two", launcher, node) for node in range(2)]
    said = [machine.communicate(timeout=300)[1] for machine in machines]
    assert [machine.returncode for machine in machines] == [0, 0], said
    kept = [torch.load(folder / "kept.pt", weights_only=True) for folder in (tmp_path / "two", of_two)]
    assert torch.equal(kept[0]["layer.weight"], kept[1]["layer.weight"])


@together
def test_the_network_learns_with_two_processes_as_with_one(tmp_path, monkeypatch, capsys):
    """The same command with ``--devices 2`` and the same samples a step. The mean logarithm of the losses in the second
    half of the log lies as near to those with one process, of other seeds, as these to each other: within four standard
    deviations of a difference, which are taken for 0.05 at least, as three seeds may agree by chance."""
    monkeypatch.chdir(tmp_path)
    common = ["--category", "laptop", "--objects", "4", "--threads", "1", "--device", "cpu"]
    net = [*common, "--steps", "80", "--batch", "8"]

    def curve(name: str, *words: str) -> float:
        command = ["train", "net", *net, "--output", name, *words]
        if "--devices" in words:  # a program of its own, which the second process runs, too
            done = subprocess.run(
                [sys.executable, "-m", "omad", *command, "--json"], capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr
            assert json.loads(done.stdout) == {"checkpoint": name}  # one object, whatever number of processes
        else:
            assert answer(capsys, *command) == {"checkpoint": name}
        losses = [row["loss"] for row in rows(tmp_path / name)]
        return float(torch.tensor(losses[len(losses) // 2 :]).log().mean())

    alone = torch.tensor([curve(f"one-{seed}", "--seed", str(seed)) for seed in range(3)])
    two = curve("two", "--devices", "2", "--seed", "3")
    spread = float(alone.std()) * (1 + 1 / len(alone)) ** 0.5
    assert abs(two - float(alone.mean())) < 4 * max(spread, 0.05)
