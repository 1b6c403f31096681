"""README and guide do what they say: their Python runs, their commands run as written."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.pages import blocks
from omad.cli.main import parse, run
from omad.data.procedural import generate
from omad.data.rendering.standard_views import View, standard_view
from omad.objects.category_file import get_category
from omad.objects.urdf import write_urdf
from omad.sensing.observation import Observation

ROOT = Path(__file__).parents[2]
README, GUIDE = (ROOT / name for name in ("README.md", "docs/guide.md"))
PAGES = [README, GUIDE, *(ROOT / "docs" / name for name in ("index.md", "tracking.md"))]
"""Whose Python runs here; other pages have tests of their own."""


@pytest.fixture
def view(tmp_path, monkeypatch) -> View:
    """A laptop in front of the camera of the README, and the files that the README names."""
    category = get_category("laptop")
    view = standard_view(generate(category, 0, "test"), category, (0, 1000))
    Image.fromarray(np.rint(view.depth * 1000).astype(np.uint16)).save(tmp_path / "depth.png")
    write_urdf(generate(category, 1, "test"), tmp_path / "models" / "one" / "one.urdf")
    monkeypatch.chdir(tmp_path)
    return view


@pytest.mark.slow
@pytest.mark.parametrize("source", PAGES, ids=lambda path: path.name)
def test_python_runs(source, view, tmp_path):
    category = get_category("laptop")
    other = standard_view(generate(category, 0, "test"), category, (0, 1001), states=view.states)
    names = {
        "depth_m": view.depth,
        "K": view.camera.K,
        "mask": view.depth > 0,
        "folder": tmp_path / "models",
        "view": Observation.from_depth(view.depth, view.camera),
        "depths_m": [view.depth, other.depth],
        "T_world_camera": np.linalg.inv([view.T_camera_base, other.T_camera_base]),
    }
    found = blocks(source, "python")
    assert found
    for code in found:
        exec(code, names)
    if source == README:
        assert (tmp_path / "laptop.urdf").is_file()
        assert (tmp_path / "laptop.png").is_file()


def commands(path: Path) -> list[list[str]]:
    lines = [line.split("#")[0].strip() for block in blocks(path, "") for line in block.splitlines()]
    return [shlex.split(line) for line in lines if line]


@pytest.mark.slow
def test_commands_run_as_written(view, capsys):
    ran = set()
    for words in commands(README):
        if words[:2] in (["omad", "train"], ["omad", "eval"]):
            continue
        if words[0] == "omad":
            assert run(words[1:]) == 0, words
            ran.add(words[1])
    assert {"estimate", "generate", "render", "info"} <= ran
    assert run(["eval", "pose", "--category", "laptop", "--source", "views"]) == 0
    assert Path("omad-estimate/depth/estimate.json").is_file()


@pytest.mark.parametrize("page", [README, *sorted((ROOT / "docs").glob("*.md"))], ids=lambda path: path.name)
def test_every_command_is_well_formed(page):
    """Trainings and full evaluations take too long to run here: they must at least be commands."""
    for words in commands(page):
        if words[0] == "omad":
            assert parse(words[1:]) is not None, words
