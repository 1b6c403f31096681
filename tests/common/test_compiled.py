"""Compiled code is kept wherever that can be, loaded by those that come later, and never a reason to fail."""

import io
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from omad.common.stderr import is_watched, tell

MODULE = """
import sys
import numpy as np
from omad.common.compiled import COMPILED, inner, jit

@inner
def squared(x):
    return x * x

@jit
def norm(values):
    total = values[0] * 0
    for value in values:
        total += squared(value)
    return np.sqrt(total)

if __name__ == "__main__":
    import kept  # functions of __main__ are kept by another name
    for dtype in sys.argv[1:]:
        print(float(kept.norm(np.array([3, 4], dtype))), len(kept.COMPILED.names))
"""
TOLD = "omad: compiling for this machine, once"


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / "kept.py").write_text(MODULE)
    return tmp_path


def start(folder: Path, *dtypes: str, **environment: str) -> subprocess.Popen:
    own = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1", **environment}
    command = [sys.executable, str(folder / "kept.py"), *dtypes]
    return subprocess.Popen(command, env=own, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(process: subprocess.Popen) -> tuple[list[list[str]], str]:
    """Words of the lines on stdout, and stderr."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return [line.split() for line in out.splitlines()], err


def test_a_machine_compiles_once_and_says_so(folder):
    out, err = ended(start(folder, "float64"))
    assert out == [["5.0", "2"]]
    assert err.count(TOLD) == len(err.splitlines()) == 1
    out, err = ended(start(folder, "float64"))
    assert (out, err) == ([["5.0", "0"]], "")


FAILS = """
import kept
import numpy as np
from numba.core.errors import TypingError
try:
    kept.norm(["no number"])
except TypingError:
    print(float(kept.norm(np.array([3.0, 4.0]))), len(kept.COMPILED.names))
"""


def test_a_compilation_that_failed_keeps_nobody_waiting(folder):
    (folder / "kept.py").write_text(MODULE)
    (folder / "fails.py").write_text(FAILS)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run(
        [sys.executable, "fails.py"], cwd=folder, env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.stdout.split()[0] == "5.0", done.stderr


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs a shell that closes streams")
def test_who_reads_no_notices_gets_answers_alone(folder):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    command = ["bash", "-c", f'"{sys.executable}" "{folder}/kept.py" float64 2>&-']
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "5.0 2\n")


def test_a_notice_that_nobody_can_read_is_no_error(monkeypatch):
    closed = io.StringIO()
    closed.close()
    for stderr in (closed, None):
        monkeypatch.setattr(sys, "stderr", stderr)
        tell("nobody hears this")
        assert stderr is closed or not is_watched()


@pytest.mark.slow
def test_processes_with_a_cold_cache_compile_once_between_them(folder):
    kinds = ["float32", "float64", "int64", "int32"]
    processes = [start(folder, *kinds[i % 4 :], *kinds[: i % 4]) for i in range(8)]
    found = [ended(process)[0] for process in processes]
    assert {answer for out in found for answer, _ in out} == {"5.0"}
    assert sum(int(out[-1][1]) for out in found) == 2 * len(kinds)


@pytest.mark.parametrize("damage", [b"", b"\x80\x04nonsense"])
def test_damaged_files_are_compiled_anew(folder, damage):
    ended(start(folder, "float64"))
    for file in (folder / "cache").rglob("*.nb?"):
        file.write_bytes(damage)
    assert ended(start(folder, "float64"))[0] == [["5.0", "2"]]
    assert ended(start(folder, "float64"))[0] == [["5.0", "0"]]


def nowhere(folder: Path) -> dict[str, str]:
    """An environment in which Numba finds no folder that it can write."""
    (folder / "__pycache__").write_text("no folder")
    (folder / "tmp").mkdir()
    bad = ("NUMBA_CACHE_DIR", "HOME", "XDG_CACHE_HOME")
    return {**dict.fromkeys(bad, str(folder / "kept.py" / "below a file")), "TMPDIR": str(folder / "tmp")}


def test_where_nothing_can_be_written_temporary_files_serve(folder):
    environment = nowhere(folder)
    assert ended(start(folder, "float64", **environment))[0] == [["5.0", "2"]]
    [private] = (folder / "tmp").iterdir()
    assert private.stat().st_mode & 0o077 == 0
    assert ended(start(folder, "float64", **environment))[0] == [["5.0", "0"]]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no users here")
def test_a_folder_that_others_may_write_is_not_trusted(folder):
    environment = nowhere(folder)
    planted = folder / "tmp" / f"omad-compiled-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)
    assert ended(start(folder, "float64", **environment))[0] == [["5.0", "2"]]
    assert not list(planted.iterdir())
    assert ended(start(folder, "float64", **environment))[0] == [["5.0", "2"]]


FIRST = """
import numpy as np, omad
from omad.common import compiled
asked, load = [], compiled._KeptCode.load_overload
compiled._KeptCode.load_overload = lambda self, *types: asked.append(types) or load(self, *types)
depth = np.ones((60, 60), np.float32) + np.linspace(0, 0.4, 60, dtype=np.float32)[:, None]
K = 60, 60, 29.5, 29.5
mask = np.pad(np.ones((50, 50), bool), 5)
estimator = omad.Estimator.from_pretrained("laptop")
before = len(asked)
view = omad.Observation.from_depth(depth, K, mask)
estimator(view), estimator([view] * 3)
for array in (depth, mask, view.points):  # as other processes share them
    array.setflags(write=False)
estimator(omad.Observation.from_depth(depth, K, mask)).part_labels
estimator(omad.Observation(points=view.points)).part_labels
print(before, len(asked), len(compiled.COMPILED.names))
"""


@pytest.mark.slow
def test_no_answer_waits_for_the_compiler():
    """All that the way to an answer needs is compiled, or loaded, when the estimator is made."""
    _, warm = (subprocess.run([sys.executable, "-c", FIRST], capture_output=True, text=True) for _ in range(2))
    before, after, compiled = map(int, warm.stdout.split())
    assert before == after > 10
    assert (compiled, warm.stderr) == (0, "")
