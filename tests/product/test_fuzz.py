"""A few hundred spoilt files; ``python benchmarks/fuzz.py`` reads thousands, with an eye on time and memory."""

import zlib

import numpy as np
import pytest

from helpers.fuzzing import Target, attempt, targets

EACH = 15
NAMES = [
    "depth png", "depth tif", "depth npy", "depth npz", "cloud c.xyz", "cloud c.ply", "cloud a.pcd", "cloud b.pcd",
    "cloud c.npz", "mask json", "mask png", "camera json", "camera yaml", "camera text", "transform", "times", "truth",
    "spec toml", "category", "urdf", "import", "imported", "views", "index", "checkpoint",
]  # fmt: skip


@pytest.fixture(scope="module")
def known(tmp_path_factory) -> dict[str, Target]:
    return {target.name: target for target in targets(tmp_path_factory.mktemp("good"))}


def test_all_readers_are_tried(known):
    assert list(known) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_spoilt_files_are_refused_in_one_line(name, known, tmp_path):
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    failures = []
    for number in range(EACH):
        (tmp_path / str(number)).mkdir()
        failures.append(attempt(known[name], rng, tmp_path / str(number)))
    assert not [failure for failure in failures if failure]


def test_the_fuzzer_finds_what_is_wrong(known, tmp_path):
    """A reader that lets everything through, and one that gives what is no number."""
    rng = np.random.default_rng(0)
    good = {"a.json": b'{"a": 1}'}

    def crash(folder):
        raise KeyError("a")

    assert "KeyError" in str(attempt(Target("crash", good, crash), rng, tmp_path))
    assert "not a number" in str(attempt(Target("nan", good, lambda folder: np.full(3, np.nan)), rng, tmp_path))
