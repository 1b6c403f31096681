"""What catalogues on disk take for the same source, and what for another one."""

import importlib.util
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from helpers.categories import LAPTOP
from helpers.command_line import LAPTOP as OF_LAPTOP
from helpers.command_line import answer, refused
from omad.applications.cluster import engines
from omad.cli.main import run
from omad.data.procedural import generate
from omad.data.rendering.view_folder import open_views
from omad.data.source import load_models
from omad.objects.urdf import write_urdf

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("faiss") is None, reason="FAISS is not installed (extra omad[faiss])"
)
ON_DISK = ["index", "build", *OF_LAPTOP, "--output", "large", "--backend", "disk"]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def rendered(capsys: pytest.CaptureFixture[str], views: int) -> None:
    assert run(["render", *OF_LAPTOP, "--objects", "2", "--views", str(views), "--output", "views"]) == 0
    capsys.readouterr()


@pytest.mark.slow
def test_a_folder_of_models_that_is_called_like_a_category_is_a_folder(capsys):
    for index in range(2):
        write_urdf(replace(generate(LAPTOP, index, "test"), name=str(index)), f"laptop/{index}/{index}.urdf")
    assert answer(capsys, *ON_DISK, "--source", "laptop")["entries"] == 2
    assert answer(capsys, *ON_DISK, "--source", "./laptop")["entries"] == 2
    write_urdf(replace(generate(LAPTOP, 9, "test"), name="1"), "laptop/1/1.urdf")
    assert "are not those" in refused(capsys, *ON_DISK, "--source", "laptop")


@pytest.mark.slow
def test_views_rendered_again_under_the_same_names_are_other_views(capsys):
    rendered(capsys, 4)
    assert answer(capsys, *ON_DISK, "--source", "views")["entries"] == 2
    again = next(Path("views").glob("*/00001.json"))
    os.utime(again, (time.time() + 9, time.time() + 9))
    assert "read with other options" in refused(capsys, *ON_DISK, "--source", "views")


@pytest.mark.slow
def test_an_entry_an_object_is_made_of_all_of_its_rendered_views(capsys):
    rendered(capsys, 140)  # more than are worked on together
    made = answer(capsys, *ON_DISK, "--source", "views")
    assert made["entries"] == 2
    assert answer(capsys, *ON_DISK, "--source", "views")["entries"] == 2
    views = open_views("views")
    by_object = [view.seed for view in replace(views, by_object=True)]
    assert sorted(by_object) == sorted(view.seed for view in views)
    assert [seed[1] for seed in by_object] == [0] * 70 + [1] * 70
    assert [view.seed for view in replace(views, by_object=True).after(71)] == by_object[71:]


@pytest.mark.slow
def test_an_address_is_the_same_source_wherever_one_works_and_whatever_the_seed(capsys, tmp_path, monkeypatch):
    pytest.importorskip("fsspec", reason="addresses need fsspec: pip install 'omad[cluster]'")
    pytest.importorskip("pyarrow", reason="Parquet files need PyArrow: pip install 'omad[parquet]'")
    monkeypatch.setattr(engines, "choose_engine", lambda *_, **__: lambda plan, numbers: map(plan, numbers))
    address = f"file://{tmp_path}/shards"
    make = ["render", *OF_LAPTOP, "--objects", "2", "--views", "2", "--cluster", "--output", address]
    assert run(make) == 0
    capsys.readouterr()
    on_disk = [*ON_DISK, "--output", str(tmp_path / "large"), "--source", address]
    assert answer(capsys, *on_disk)["entries"] == 2
    assert answer(capsys, *on_disk, "--seed", "5")["entries"] == 2
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    assert answer(capsys, *on_disk)["entries"] == 2


@pytest.mark.slow
def test_of_two_that_add_the_same_at_once_the_second_adds_what_the_first_has_not(capsys, monkeypatch):
    begun = list[bool]()

    def while_another_does_the_same(*arguments: Any) -> Any:
        if not begun:
            begun.append(True)
            assert answer(capsys, *ON_DISK, "--objects", "2")["entries"] == 2
        return load_models(*arguments)

    monkeypatch.setattr("omad.cli.index.load_models", while_another_does_the_same)
    assert answer(capsys, *ON_DISK, "--objects", "3")["entries"] == 3


def test_objects_of_the_other_hand_are_refused_where_the_prior_has_to_know_them(capsys):
    for command in ("index build --output i.npz", "eval keypoints", "figure keypoints"):
        words = [*command.split(), "--category", "refrigerator", "--source", "mirrored", "--objects", "2"]
        assert "is of the other hand" in refused(capsys, *words)
