"""Options that would have no effect, or another one than it seems, are refused in one line."""

from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import LAPTOP, K, refused, save_png


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        "detect a.png --categories laptop --categories oven",
        "detect a.png --category laptop --categories=oven",
        "estimate a.png --category laptop --formats ply --formats glb",
    ],
)
def test_lists_that_are_given_twice(words, capsys):
    """Of which the first would be forgotten."""
    assert "was given before, and only the last counts; put all behind one --" in refused(capsys, *words.split())


@pytest.mark.parametrize("option", ["--mask x.png", "--box 1,2,3,4", "--intrinsics k.json", "--depth-scale 0.5"])
def test_how_to_read_what_is_not_read(option, capsys):
    line = refused(capsys, "index", "build", *LAPTOP, *option.split(), "--output", "i.npz")
    assert f"{option.split()[0]}: goes with a folder of depth images or clouds" in line
    assert f"{option.split()[0]}: goes with --depth" in refused(capsys, "explore", "laptop", *option.split())


def test_lenses_of_clouds_and_lenses_of_too_few_numbers(capsys):
    np.save("cloud.npy", np.random.default_rng(0).random((900, 3)))
    words = ["estimate", "cloud.npy", *LAPTOP, "--distortion"]
    assert "--distortion needs a depth image" in refused(capsys, *words, "0.1,0,0,0,0")
    assert "give k1,k2,p1,p2,k3" in refused(capsys, *words, "equidistant:1,2")


def test_folders_that_are_not_there_or_are_the_input(capsys):
    Path("models").mkdir()
    words = ["import", "models", *LAPTOP, "--output", "o", "--mesh-folder", "nothere"]
    assert "--mesh-folder nothere: no such folder" in refused(capsys, *words)
    save_png("frames/0.png")
    line = refused(capsys, "track", "frames", *LAPTOP, *K, "--output", "./frames/")
    assert "is the folder of the frames; give another" in line
    assert [file.name for file in Path("frames").iterdir()] == ["0.png"]
