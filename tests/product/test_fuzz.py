"""A few hundred spoilt inputs; ``python benchmarks/tools/fuzz.py`` tries thousands, with an eye on time and memory."""

import zlib
from pathlib import Path

import numpy as np
import pytest

from helpers.fuzzing.calls import calls
from helpers.fuzzing.commands import commands
from helpers.fuzzing.readers import readers
from helpers.fuzzing.trial import Call, Command, Target

EACH = 15
READERS = [
    "depth png", "depth tif", "depth npy", "depth npz", "cloud c.xyz", "cloud c.ply", "cloud a.pcd", "cloud b.pcd",
    "cloud c.npz", "mask json", "mask png", "camera json", "camera yaml", "camera text", "transform", "times", "truth",
    "spec toml", "category", "urdf", "import", "imported", "views", "index", "checkpoint",
]  # fmt: skip
CALLS = [
    "known", "from depth", "from points", "estimator", "estimate points", "several views", "tracker", "index", "stream",
    "configuration", "explorer request", "explorer name", "mask", "path of read_depth", "path of read_cloud",
    "path of read_mask", "path of read_camera", "path of get_category", "path of find_weights", "path of a transform",
]  # fmt: skip


@pytest.fixture(scope="module")
def known(tmp_path_factory) -> dict[str, Target]:
    return {target.name: target for target in readers(tmp_path_factory.mktemp("good"))}


@pytest.fixture(scope="module")
def callable_() -> dict[str, Call]:
    return {call.name: call for call in calls()}


@pytest.fixture(scope="module")
def runnable(tmp_path_factory) -> list[Command]:
    return commands(tmp_path_factory.mktemp("good"))


def test_all_of_them_are_tried(known, callable_):
    assert list(known) == READERS
    assert list(callable_) == CALLS


@pytest.mark.parametrize("name", READERS)
def test_spoilt_files_are_refused_in_one_line(name, known, tmp_path):
    assert not tried(known[name], EACH, tmp_path)


@pytest.mark.parametrize("name", CALLS)
def test_odd_arguments_are_refused_in_one_line(name, callable_, tmp_path):
    assert not tried(callable_[name], EACH, tmp_path)


@pytest.mark.slow
def test_commands_with_spoilt_files_and_options_end_with_one_line(runnable, tmp_path):
    assert not [failure for command in runnable for failure in tried(command, 2, tmp_path)]


def tried(target: Target | Command | Call, count: int, folder: Path) -> list[str]:
    """What goes wrong with so many inputs."""
    rng, failures = np.random.default_rng(zlib.crc32(target.name.encode())), []
    for number in range(count):
        place = folder / f"{type(target).__name__}-{target.name}-{number}"
        place.mkdir()
        failures.append(target.attempt(rng, place))
    return [f"{target.name}: {failure}" for failure in failures if failure]


def test_the_fuzzer_finds_what_is_wrong(tmp_path):
    """A reader that lets everything through, one that gives what is no number, and a command without end of words."""
    good = {"a.json": b'{"a": 1}'}

    def crash(folder):
        raise KeyError("a")

    (tmp_path / "one").mkdir()
    assert "KeyError" in tried(Target("crash", good, crash), 1, tmp_path / "one")[0]
    (tmp_path / "two").mkdir()
    assert "not a number" in tried(Target("nan", good, lambda folder: np.full(3, np.nan)), 1, tmp_path / "two")[0]
