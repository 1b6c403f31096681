"""Drills: commands that are killed, whose disk is full, and many at a time. ``OMAD_KILLS=100`` kills so often;
``python benchmarks/tools/kill_drill.py`` does so for all commands together."""

import os
from pathlib import Path

import pytest

from helpers.command_line import LAPTOP, K
from helpers.drills import DRILLS, Drill, begin, kill_and_finish, lay_out, prepare, written

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name == "nt", reason="limits and signals as POSIX has them")]
KILLS = int(os.environ.get("OMAD_KILLS", "2"))
SMALL = 200
"""Bytes, which no file may exceed where the disk is full."""
KNOWN = {drill.name: drill for drill in DRILLS}
ESTIMATE = Drill("estimate", ["estimate", "frames/frame_00.png", *LAPTOP, *K, "--output", "out"])


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    prepare()


@pytest.mark.parametrize("name", KNOWN)
def test_what_was_killed_is_done_by_the_next_run(name):
    assert not kill_and_finish(KNOWN[name], KILLS, 0)


@pytest.mark.parametrize("drill", [*DRILLS, ESTIMATE], ids=lambda drill: drill.name)
def test_a_full_disk_is_one_line(drill):
    lay_out(drill)
    before = {path: path.read_bytes() for path in Path("out").rglob("*") if path.name in drill.begun}
    code, err = begin(drill, SMALL).end()
    said = [line for line in err.splitlines() if line.startswith("omad: ") and "compiling" not in line]
    assert code == 1, err
    assert "Traceback" not in err
    assert len(said) == 1
    assert "cannot be written (File too large)" in said[0]
    assert not [path for path in Path().rglob(".omad-*")]
    assert all(path.read_bytes() == content for path, content in before.items())


def test_a_full_disk_leaves_a_trainings_state():
    train = KNOWN["train prior"]
    begin(train).end()
    before = Path("out/state.pt").read_bytes()
    assert begin(train, SMALL).end()[0] == 1
    assert Path("out/state.pt").read_bytes() == before


def test_many_at_a_time_write_what_one_writes():
    """Six processes in one folder, which all compile, sweep and write the same files."""
    alone = Drill("render", [*KNOWN["render"].arguments[:-1], "alone"])
    assert begin(alone).end()[0] == 0
    running = [begin(KNOWN["render"]) for _ in range(6)]
    ended = [process.end() for process in running]
    assert all("Traceback" not in err for _, err in ended), ended
    assert begin(KNOWN["render"]).end()[0] == 0
    assert written(Path("out")) == written(Path("alone"))
    assert not list(Path().rglob(".omad-*"))
