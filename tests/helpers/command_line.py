"""What the tests of the command line share: one rendered view in all its forms, and how a command is run."""

import json
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from omad.cli.main import run
from omad.data.procedural import generate
from omad.data.rendering.standard_views import View, standard_view
from omad.objects.category_file import get_category

K = ["--intrinsics", "600,600,319.5,239.5"]
LAPTOP = ["--category", "laptop"]


@cache
def laptop_view() -> View:
    category = get_category("laptop")
    return standard_view(generate(category, 0, "test"), category, (0, 1000))


def cloud() -> np.ndarray:
    """The laptop's points (N, 3) in the camera frame."""
    rows, columns = np.nonzero(laptop_view().depth)
    z = laptop_view().depth[rows, columns]
    return np.stack([(columns - 319.5) / 600 * z, (rows - 239.5) / 600 * z, z], 1)


def save_png(path: str, depth: np.ndarray | None = None) -> str:
    """16 bit, millimetres; without ``depth`` the laptop's."""
    depth = laptop_view().depth if depth is None else depth
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(depth * 1000).astype(np.uint16)).save(path)
    return path


def answer(capsys, *arguments: str, code: int = 0) -> dict:
    """Run with --json; stdout must hold one JSON object and nothing else."""
    assert run([*arguments, "--json"]) == code
    return json.loads(capsys.readouterr().out, parse_constant=lambda name: f"{name} is not JSON")


CACHES = {"__pycache__", ".pytest_cache", ".hypothesis"}
"""In which tests beside this one keep what they compiled or saw, where the current folder is the checkout."""


def _files() -> set[Path]:
    """Below the current folder."""
    return {path for path in Path().rglob("*") if path.is_file() and not CACHES & {*path.parts}}


def refused(capsys, *arguments: str) -> str:
    """The one line on stderr that a bad input gives, with exit code 2, nothing on stdout and no file written."""
    before = _files()
    capsys.readouterr()
    assert run([*arguments]) == 2
    captured = capsys.readouterr()
    told = "omad: compiling for this machine"  # where it is the first to need it
    lines = [line for line in captured.err.strip().splitlines() if not line.startswith(told)]
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("omad: ")
    assert captured.out == ""
    assert not _files() - before
    return lines[0]
