"""Drawers whose axis points into their cabinet: all of it would be taken back to front."""

import re

import pytest

from omad.data.procedural import generate
from omad.data.urdf_import.folder import WRONG_WAY, import_with_notes
from omad.data.urdf_import.walls import through_walls
from omad.objects.category_file import get_category
from omad.objects.urdf import write_urdf


@pytest.mark.parametrize("name", ["drawer", "drawer_1", "drawer_2", "drawer_4", "drawer_5", "dishwasher"])
def test_no_drawer_leaves_through_a_wall(name):
    made = [generate(get_category(name), index, split) for index in range(4) for split in ("test", "unusual")]
    assert not any(map(through_walls, made))


def test_a_drawer_that_leaves_at_the_back_is_told_of(tmp_path):
    category, file = get_category("drawer_2"), tmp_path / "chest.urdf"
    chest = generate(category, 0, "test")
    write_urdf(chest, file)
    assert import_with_notes(file, category).notes == []
    text, axes = re.subn(r'axis xyz="([^"]*)"', _other_way, file.read_text())
    assert axes == 2
    file.write_text(text)
    told = f"top_drawer, bottom_drawer open through a wall: where their {WRONG_WAY}"
    assert import_with_notes(file, category).notes == [told]


def _other_way(axis: re.Match[str]) -> str:
    return 'axis xyz="' + " ".join(str(-float(number)) for number in axis[1].split()) + '"'
