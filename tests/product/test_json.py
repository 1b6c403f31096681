"""Every field of the JSON that commands write is explained in docs/json.md."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.command_line import LAPTOP, K, answer, save_png
from omad.data.rendering.tabletop import draw_tabletop

PAGE = Path(__file__).parents[2] / "docs" / "json.md"


def fields(record: Any) -> Iterator[str]:
    """Names of all fields, but of those that are categories' and joints' names."""
    if isinstance(record, list):
        for each in record:
            yield from fields(each)
    if isinstance(record, dict):
        for name, value in record.items():
            yield name
            yield from () if name == "probabilities" else fields(value)


@pytest.mark.slow
def test_every_field_is_explained(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scene = draw_tabletop(("laptop",), (2, 5))
    np.savetxt("pose.txt", np.eye(4))
    for name in ("a", "b"):
        save_png(f"frames/{name}.png")
    one = answer(capsys, "estimate", "frames/a.png", *LAPTOP, *K, "--world", "pose.txt", "--compare", "--to-surface")
    bad = answer(capsys, "estimate", save_png("far.png", 3 * scene.depth), "frames/a.png", *LAPTOP, *K, code=2)
    detected = answer(capsys, "detect", save_png("table.png", scene.depth), *K, "--categories", "laptop")
    answer(capsys, "track", "frames", *LAPTOP, *K, "--fps", "5", "--output", "track")
    tracked = [json.loads(line) for line in Path("track/frames.jsonl").read_text().splitlines()]
    told = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]*)`", PAGE.read_text()))))
    assert {*fields([one, bad, detected, tracked])} - told == set()
