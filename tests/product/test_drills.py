"""Drills: commands that are killed, and commands whose disk is full. ``OMAD_KILLS=100`` kills so often."""

import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from helpers.own_models import write_microwaves

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name == "nt", reason="limits and signals as POSIX has them")]
KILLS = int(os.environ.get("OMAD_KILLS", "4"))
SPEC = str(Path(__file__).parents[2] / "docs" / "categories" / "microwave.toml")
LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
from omad.__main__ import main
main()
"""
COMMANDS = {
    "generate": ["generate", "--category", "laptop", "--objects", "2", "--output", "out"],
    "render": ["render", "--category", "laptop", "--objects", "2", "--views", "6", "--output", "out"],
    "import": ["import", "models", "--category", SPEC, "--output", "out"],
    "train": ["train", "prior", "--category", "laptop", "--objects", "2", "--steps", "30", "--batch", "2",
              "--seed", "1", "--threads", "1", "--device", "cpu", "--save-seconds", "0.01", "--output", "out"],
    "index": ["index", "build", "--category", "laptop", "--source", "procedural", "--objects", "2",
              "--output", "out/i.npz"],
    "export": ["export", "--category", "laptop", "--output", "out"],
}  # fmt: skip


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_microwaves(Path("models"), 2)


def omad(name: str, *before: str) -> subprocess.Popen:
    command = [sys.executable, *(before or ("-m", "omad")), *COMMANDS[name]]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def done(process: subprocess.Popen) -> str:
    """What it says on stderr, once it has ended well."""
    _, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    return err


def written() -> dict[str, str]:
    """Digests of all files but those that tell times, and PNGs of matplotlib."""
    told = ("metrics.jsonl", "state.pt", "models.png", "import.json")
    files = (path for path in Path("out").rglob("*") if path.is_file())
    kept = (path for path in files if path.name not in told and "tfevents" not in path.name)
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in kept}


@pytest.mark.parametrize("name", ["generate", "render", "import", "train", "index"])
def test_what_was_killed_is_done_by_the_next_run(name):
    began = time.monotonic()
    done(omad(name))
    lasts, whole = time.monotonic() - began, written()
    assert whole
    Path("out").rename("whole")
    rng = np.random.default_rng(0)
    for share in rng.uniform(0.2, 1.0, KILLS):
        process = omad(name)
        time.sleep(float(share) * lasts)
        process.kill()
        process.communicate()
    done(omad(name))
    # two trainings of so few objects differ (an SVD's signs hang on last digits), and archives tell when they were made
    assert written().keys() == whole.keys()
    assert name in ("train", "index") or written() == whole
    assert not list(Path("out").rglob(".omad-*"))


@pytest.mark.parametrize("name", ["generate", "render", "import", "train", "index", "export"])
def test_a_full_disk_is_one_line(name):
    process = omad(name, "-c", LIMITED, "2000")
    _, err = process.communicate(timeout=600)
    said = [line for line in err.splitlines() if line.startswith("omad: ") and "compiling" not in line]
    assert process.returncode == 1, err
    assert "Traceback" not in err
    assert len(said) == 1
    assert "cannot be written (File too large)" in said[0]
    assert not [path for path in Path().rglob(".omad-*")]


def test_a_full_disk_leaves_a_trainings_state():
    done(omad("train"))
    before = Path("out/state.pt").read_bytes()
    process = omad("train", "-c", LIMITED, "2000")
    process.communicate(timeout=600)
    assert process.returncode == 1
    assert Path("out/state.pt").read_bytes() == before
