"""``omad bulk``: one file of numbers for many images, whatever ends it on the way."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.command_line import LAPTOP, K, answer, laptop_view, refused, save_png
from helpers.warm import Command
from omad.applications.bulk.results import Results
from omad.applications.cluster import engines
from omad.cli.main import run
from omad.data.shards.store import Store


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def rows(path: str) -> list[dict]:
    return [json.loads(line) for line in Path(path).read_text().splitlines()]


def test_bad_images_are_rows_of_their_own(capsys):
    save_png("views/a.png")
    save_png("views/c.png")
    Image.fromarray(np.zeros((480, 640), np.uint16)).save("views/b.png")
    found = answer(capsys, "bulk", "views", *LAPTOP, *K, "--output", "out.jsonl", code=2)
    assert (found["images"], found["refused"], found["done_before"]) == (3, 1, 0)
    first, bad, last = rows("out.jsonl")
    assert (first["name"], bad["name"]) == ("views/a.png", "views/b.png")
    assert "no pixel holds a measurement" in bad["refused"]
    assert list(first) == list(last)
    for key in ("converged", "category", "warnings"):
        assert first[key] == last[key]
    # where an image stands in a batch decides how products of matrices are rounded, on some machines
    np.testing.assert_allclose(first["T_camera_base"], last["T_camera_base"], atol=1e-6)
    np.testing.assert_allclose(first["beta"], last["beta"], atol=1e-5)
    single = answer(capsys, "estimate", "views/a.png", *LAPTOP, *K)
    assert first["joints"][0]["state"] == pytest.approx(single["joints"][0]["state"], abs=1e-6)


def test_a_refused_image_is_named_once(capsys):
    save_png("views/a.png")
    blank = np.zeros((480, 640), np.uint16)
    Image.fromarray(blank).save("views/b.png")
    np.save("stack.npy", blank[None])
    capsys.readouterr()
    assert run(["bulk", "views", "stack.npy", *LAPTOP, *K, "--output", "out.jsonl"]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "no pixel holds a measurement" in line]
    assert [line.partition(": depth: ")[0] for line in lines] == ["omad: views/b.png", "omad: stack.npy[0]"]
    assert "views/b.png" not in lines[0].partition(": depth: ")[2]


def test_a_folder_of_folders_as_render_writes_it_is_read_with_what_lies_beside_the_images(capsys):
    answer(capsys, "render", *LAPTOP, "--output", "views", "--views", "4", "--objects", "2")
    found = answer(capsys, "bulk", "views", *LAPTOP, "--output", "out.jsonl")
    assert (found["images"], found["refused"]) == (4, 0)
    names = [Path(row["name"]) for row in rows("out.jsonl")]
    assert len({name.parent for name in names}) == 2
    truths = [
        json.loads(name.with_name(name.name.replace(".depth.png", ".json")).read_text())["states"] for name in names
    ]
    off = [row["joints"][0]["state"] - states[0] for row, states in zip(rows("out.jsonl"), truths, strict=True)]
    assert np.degrees(np.median(np.abs(off))) < 5


def test_what_is_wrong_for_all_is_said_at_once(capsys):
    save_png("views/a.png")
    usual = ["bulk", "views", *LAPTOP, *K, "--output"]
    assert "ends in .jsonl or .parquet" in refused(capsys, *usual, "out.csv")
    assert "--intrinsics" in refused(capsys, "bulk", "views", *LAPTOP, "--output", "out.jsonl")
    assert "--workers -1" in refused(capsys, *usual, "out.jsonl", "--workers", "-1")
    assert "--batch 0" in refused(capsys, *usual, "out.jsonl", "--batch", "0")
    Path("out.jsonl").write_text("precious")
    assert "out.jsonl: is there already" in refused(capsys, *usual, "out.jsonl")
    np.save("empty.npy", np.zeros((0, 48, 64), dtype=np.float32))
    assert "empty.npy: holds no image" in refused(capsys, "bulk", "empty.npy", *LAPTOP, *K, "--output", "out2.jsonl")
    os.mkfifo("piped.jsonl.part")
    assert "piped.jsonl.part: is no file" in refused(capsys, *usual, "piped.jsonl")


def test_a_run_does_not_go_on_with_other_files(capsys, monkeypatch):
    """Though they are as many, and the last one that is done is the same."""
    for name in "abc":
        save_png(f"views/{name}.png")
    usual = ["bulk", "views", *LAPTOP, *K, "--batch", "1", "--output", "out.jsonl"]
    with monkeypatch.context() as killed:
        killed.setattr(Results, "finish", lambda _: None)
        answer(capsys, *usual)
    os.rename("views/a.png", "views/aa.png")
    assert "other inputs or settings" in refused(capsys, *usual)
    os.rename("views/aa.png", "views/a.png")
    assert answer(capsys, *usual)["done_before"] == 3


def test_a_run_does_not_go_on_with_a_file_that_was_written_anew(capsys, monkeypatch):
    np.save("stack.npy", np.stack([laptop_view().depth] * 2))
    usual = ["bulk", "stack.npy", *LAPTOP, *K, "--batch", "1", "--output", "out.jsonl"]
    with monkeypatch.context() as killed:
        killed.setattr(Results, "finish", lambda _: None)
        answer(capsys, *usual)
    np.save("stack.npy", np.stack([laptop_view().depth] * 2) + 1)
    os.utime("stack.npy", (0, 0))
    assert "other inputs or settings" in refused(capsys, *usual)


@pytest.mark.parametrize("anew", ["views/a.png", "views/a.mask.png", "views/camera.json", "masks/a.png", "k.txt"])
def test_a_run_does_not_go_on_with_what_was_written_anew(anew, capsys, monkeypatch):
    """An image, or what says how to read it, of the same name and size."""
    save_png("views/a.png")
    Path("masks").mkdir()
    for mask in ("views/a.mask.png", "masks/a.png"):
        Image.fromarray(np.uint8(255 * (laptop_view().depth > 0))).save(mask)
    Path("views/camera.json").write_text('{"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5}')
    Path("k.txt").write_text("600 0 319.5 0 600 239.5 0 0 1")
    beside = [] if anew.startswith("views") else ["--intrinsics", "k.txt", "--mask", "masks"]
    usual = ["bulk", "views", *LAPTOP, *beside, "--output", "out.jsonl"]
    with monkeypatch.context() as killed:
        killed.setattr(Results, "finish", lambda _: None)
        assert answer(capsys, *usual)["refused"] == 0
    assert len(Path("out.jsonl.part").read_bytes().splitlines()) == 1
    os.utime(anew, (0, 0))
    assert "other inputs or settings" in refused(capsys, *usual)


def test_shards_are_read_by_other_programs_and_lie_in_a_folder_of_their_own(capsys, monkeypatch):
    parquet = pytest.importorskip("pyarrow.parquet", reason="Parquet files need PyArrow: pip install 'omad[parquet]'")
    monkeypatch.setattr(engines, "choose_engine", lambda *_, **__: lambda plan, numbers: map(plan, numbers))
    for name in "abc":
        save_png(f"views/{name}.png")
    usual = ["bulk", "views", *LAPTOP, *K, "--cluster", "--shard", "2", "--output"]
    assert answer(capsys, *usual, "out")["shards"] == 2
    assert parquet.read_table("out").num_rows == 3
    assert "--output views: is one of the inputs" in refused(capsys, *usual, "views")


def test_a_store_that_does_not_answer_is_no_bad_input(capsys, monkeypatch):
    """What is tried again, in shards; a file that is no Parquet is not."""
    pytest.importorskip("fsspec", reason="addresses need fsspec: pip install 'omad[cluster]'")
    pytest.importorskip("pyarrow", reason="Parquet files need PyArrow: pip install 'omad[parquet]'")
    Store.of("memory://bucket").write("a.parquet", b"PAR1")
    usual = ["bulk", "memory://bucket/a.parquet", *LAPTOP, *K, "--output", "out.jsonl"]
    assert "not readable as Parquet" in refused(capsys, *usual)

    def busy(*_) -> None:
        raise OSError("503 Slow Down")

    monkeypatch.setattr(Store, "open", busy)
    assert run(usual) == 1
    assert "a.parquet: cannot be read (503 Slow Down); run it again" in capsys.readouterr().err


def test_a_full_disk_is_told_of_with_the_file(capsys):
    resource = pytest.importorskip("resource")
    save_png("views/a.png")
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, usual[1]))  # less than a row
    try:
        assert run(["bulk", "views", *LAPTOP, *K, "--output", "out.jsonl"]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert "out.jsonl.part: cannot be written (File too large)" in capsys.readouterr().err
    assert answer(capsys, "bulk", "views", *LAPTOP, *K, "--output", "out.jsonl")["images"] == 1


@pytest.mark.slow
def test_a_killed_run_goes_on_where_it_was(capsys):
    np.save("stack.npy", np.stack([np.roll(laptop_view().depth, i, 0) for i in range(40)]))
    arguments = ["bulk", "stack.npy", *LAPTOP, *K, "--batch", "2", "--output"]
    process = Command([*arguments, "out.jsonl"])
    while not Path("out.jsonl.part").exists() or Path("out.jsonl.part").read_bytes().count(b"\n") < 3:
        assert process.alive()
        time.sleep(0.01)
    process.kill()
    process.end()
    assert not Path("out.jsonl").exists()
    assert "other inputs or settings" in refused(capsys, *arguments, "out.jsonl", "--depth-scale", "2")
    found = answer(capsys, *arguments, "out.jsonl")
    assert 0 < found["done_before"] < 40
    assert (found["images"], found["refused"]) == (40, 0)
    assert answer(capsys, *arguments, "whole.jsonl")["done_before"] == 0
    for mended, whole in zip(rows("out.jsonl"), rows("whole.jsonl"), strict=True):
        assert mended["name"] == whole["name"]
        # processes round matrix products differently, which the fit may make more of
        assert mended["joints"][0]["state"] == pytest.approx(whole["joints"][0]["state"], abs=0.01)


def test_any_category_is_refused_where_one_has_to_be_named(capsys):
    save_png("views/d.png")
    for command in (["bulk", "views", "--output", "x.jsonl"], ["track", "views"]):
        line = refused(capsys, *command, *K, "--category", "auto")
        assert line.startswith("omad: auto: stands for any category, here one has to be named (cabinet_one_door, ")


def test_a_run_does_not_go_on_with_answers_of_another_kind(capsys, monkeypatch, tmp_path):
    """Nor are rows that were there counted among those that this run made in its time."""
    monkeypatch.chdir(tmp_path)
    for name in "ab":
        save_png(f"views/{name}.png")
    usual = ["bulk", "views", *LAPTOP, *K, "--batch", "1", "--output", "out.jsonl"]
    with monkeypatch.context() as killed:
        killed.setattr(Results, "finish", lambda _: None)
        answer(capsys, *usual)
    assert "other inputs or settings" in refused(capsys, *usual, "--fast")
    found = answer(capsys, *usual)
    assert (found["images"], found["done_before"], found["images_per_second"]) == (2, 2, 0)
