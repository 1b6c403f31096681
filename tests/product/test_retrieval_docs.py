"""docs/retrieval.md does what it says: its Python runs, its commands run as written or are at least well formed."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import laptop_view, save_png
from helpers.pages import blocks
from omad.applications.retrieval.index import ShapeIndex
from omad.cli.main import run
from omad.data.procedural import generate
from omad.objects.category_file import get_category
from omad.objects.urdf import write_urdf

PAGE = Path(__file__).parents[2] / "docs" / "retrieval.md"


@pytest.fixture(autouse=True)
def in_a_folder_with_the_files_that_the_page_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_png("depth.png")
    for index in range(2):
        write_urdf(generate(get_category("laptop"), index, "test"), Path(f"models/{index}/{index}.urdf"))


def test_python_runs():
    view = laptop_view()
    names = {"depth_m": view.depth, "K": view.camera.K, "mask": np.asarray(view.depth) > 0}
    for code in blocks(PAGE, "python"):
        exec(code, names)
    assert [entry.name for entry in ShapeIndex.load("mine.npz").entries] == ["my laptop"]
    assert len(names["hits"]) == 1


def test_commands_run():
    ran = []
    for line in "".join(blocks(PAGE, "")).splitlines():
        words = shlex.split(line.split("#")[0])
        if words[0] != "omad":
            script = next(word for word in words if word.endswith(".py"))
            assert (PAGE.parents[1] / script).is_file()
        elif words[1] == "eval" or "catalogue" in words:  # takes too long, or much, to run here: options must parse
            with pytest.raises(SystemExit) as stop:
                run([*words[1:], "--help"])
            assert stop.value.code == 0
        else:
            assert run(words[1:]) == 0, line
            ran.append(words[1:3])
    assert ran == [["index", "build"], ["index", "query"]]
    assert Path("omad-query/ranking.png").stat().st_size > 1000


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", PAGE.read_text()):
        assert (PAGE.parent / target).exists(), target
