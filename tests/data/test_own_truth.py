"""Views whose truth a person wrote: what cannot be is named, so that no number is worked out from it."""

import json
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from omad.cli.main import run
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.standard_views import ObjectTruth
from omad.data.rendering.view_folder import open_views, render_to_folder
from omad.data.rendering.view_records import ViewRecord, check_truth
from omad.geometry.camera import Camera
from omad.objects.category_file import get_category

LAPTOP = get_category("laptop")


@pytest.fixture
def folder(tmp_path) -> Path:
    render_to_folder([generate(LAPTOP, 0, "test")], LAPTOP, tmp_path / "views", 2)
    assert len(list(open_views(tmp_path / "views"))) == 2
    return tmp_path / "views"


def changed(field: str, change: Callable[[np.ndarray], Any]) -> Callable[[dict], dict]:
    return lambda record: record | {field: np.asarray(change(np.array(record[field]))).tolist()}


IN_MILLIMETRES = np.array([[1.0] * 3 + [1000.0]] * 3 + [[1.0] * 4])
WRONG = {
    "degrees": ("00000", changed("states", lambda states: states + 70), "states: are far beyond the limits"),
    "millimetres": ("00000", changed("T_camera_base", lambda T: T * IN_MILLIMETRES), "T_camera_base: .*; give metres"),
    "inverse": ("00000", changed("T_camera_base", np.linalg.inv), "T_camera_base: puts the object .* m from"),
    "scaled": ("00000", changed("T_camera_base", lambda T: T + np.diag([0, 0, 0, 1])), "T_camera_base: its last row"),
    "limits in degrees": ("object", changed("limits", np.degrees), "limits: are of many turns; give radians"),
    "boxes in millimetres": ("object", changed("part_boxes", lambda boxes: boxes * 1000), "part_boxes: .* give metres"),
}


@pytest.mark.parametrize(("file", "change", "said"), WRONG.values(), ids=WRONG)
def test_other_units_and_frames_are_named(folder, file, change, said):
    [path] = folder.rglob(f"{file}.json")
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(InputError, match=rf"{file}.*{said}"):
        list(open_views(folder))


@pytest.mark.parametrize(("zero", "said"), [(0, ""), (np.pi / 2, "in 2 of 2 views a part is not where its pixels are")])
def test_parts_that_are_mostly_not_where_their_pixels_are_are_told_of(folder, zero, said, capsys):
    for path in folder.rglob("0000*.json"):
        path.write_text(json.dumps(changed("states", lambda states: states - zero)(json.loads(path.read_text()))))
    views = open_views(folder, category=LAPTOP)
    assert len(list(views)) == len(list(islice(views, 2))) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == bool(zero)
    next(iter(open_views(folder, category=LAPTOP)))  # where no more is asked for
    assert ("in 1 of 1 views" in capsys.readouterr().err) == bool(zero)


LABELS = {
    "from one": (lambda labels: np.where(labels == 255, 0, labels + 1), "labels: 2 is no part; give 0 to 1, and 255"),
    "none": (lambda labels: np.full_like(labels, 255), "labels: no pixel is one of the object's"),
    "smaller": (lambda labels: labels[::2, ::2], r"\(320, 240\) pixels for a camera of \(640, 480\); give all"),
}


@pytest.mark.parametrize(("change", "said"), LABELS.values(), ids=LABELS)
def test_labels_that_are_none_of_the_parts_are_named(folder, change, said):
    [path] = folder.rglob("00001.labels.png")
    Image.fromarray(change(np.asarray(Image.open(path))).astype(np.uint8)).save(path)
    with pytest.raises(InputError, match=f"00001: .*{said}"):
        list(open_views(folder))


def test_what_is_not_labelled_is_not_shown(folder):
    [path] = folder.rglob("00000.depth.png")
    alone = next(iter(open_views(folder))).observation()
    stored = np.array(Image.open(path))
    stored[stored == 0] = 30_000  # a wall, 3 m away
    Image.fromarray(stored).save(path)
    assert np.array_equal(next(iter(open_views(folder))).observation().points, alone.points)


def test_an_object_that_is_listed_twice_is_named(folder):
    path = folder / "dataset.json"
    record = json.loads(path.read_text())
    path.write_text(json.dumps(record | {"objects": record["objects"] * 2}))
    with pytest.raises(InputError, match="objects: names one twice"):
        open_views(folder)


def test_views_and_views_in_shards_do_not_lie_in_one_folder(folder, capsys):
    pytest.importorskip("pyarrow", reason="Parquet files need PyArrow: pip install 'omad[parquet]'")
    shards = ["render", "--category", "laptop", "--objects", "1", "--views", "2", "--shard", "2", "--cluster"]
    assert run([*shards, "--output", str(folder)]) == 2
    assert "holds files of another program" in capsys.readouterr().err
    (folder.parent / "shards").mkdir()
    (folder.parent / "shards" / "_run.json").write_text("{}")
    assert run(["render", "--category", "laptop", "--views", "1", "--output", str(folder.parent / "shards")]) == 2
    assert "is for views in shards" in capsys.readouterr().err


def test_an_object_beside_the_middle_of_a_cut_image_is_where_its_pixels_are():
    camera, depth, labels = Camera(400, 100, 100.0, 100.0, 350.0, 50.0), np.zeros((100, 400)), np.full((100, 400), 255)
    depth[50, 350], labels[50, 350] = 1.0, 0
    T = np.eye(4)
    T[2, 3] = 1.0
    check_truth(ViewRecord(np.array([0.5]), T), ObjectTruth.of(generate(LAPTOP, 0)), camera, depth, labels)
