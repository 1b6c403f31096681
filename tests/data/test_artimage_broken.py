"""Broken files of an ArtImage root are refused, or skipped and listed, by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from helpers.artimage_roots import cut, edit
from helpers.categories import LAPTOP
from omad.common.errors import InputError
from omad.data.artimage import open_artimage
from omad.data.artimage.layout import Layout

FILE = "2000000_0000"
BREAKING: dict[str, tuple[Callable[[Layout], object], str, int]] = {
    # what is broken, what the message names, how many of the four images are left
    "depth missing": (lambda a: (a.images / f"depth/{FILE}.png").unlink(), rf"depth/{FILE}\.png: ", 3),
    "mask missing": (lambda a: (a.images / f"category_mask/{FILE}.png").unlink(), rf"category_mask/{FILE}\.png: ", 3),
    "depth cut off": (lambda a: cut(a.images / f"depth/{FILE}.png"), rf"depth/{FILE}\.png: ", 3),
    "another size": (
        lambda a: Image.new("I;16", (64, 48)).save(a.images / f"depth/{FILE}.png"),
        rf"depth/{FILE}\.png: ",
        3,
    ),
    "annotation cut off": (lambda a: cut(a.annotation(f"{FILE}.json")), rf"{FILE}\.json: ", 3),
    "annotation missing": (lambda a: a.annotation(f"{FILE}.json").unlink(), rf"{FILE}\.json: ", 3),
    "no links": (lambda a: edit_instance(a, lambda i: i.pop("links")), rf"{FILE}\.json: field 'links'", 3),
    "a link gone": (lambda a: edit_instance(a, lambda i: i["links"].pop()), rf"{FILE}\.json: field 'links'", 3),
    "no state": (lambda a: edit_instance(a, lambda i: i["links"][1].pop("state")), rf"{FILE}\.json: field 'state'", 3),
    "box": (lambda a: edit_instance(a, lambda i: i.update(bbox=[5, 5, 5, 9])), rf"{FILE}\.json: field 'bbox'", 3),
    "pose": (
        lambda a: edit_instance(a, lambda i: i["links"][0].update(transformation=[1])),
        rf"{FILE}\.json: field 'transformation'",
        3,
    ),
    "mirrored pose": (
        lambda a: edit_instance(a, lambda i: i["links"][0].update(transformation=np.diag([1, 1, -1, 1]).tolist())),
        rf"{FILE}\.json: field 'transformation'",
        3,
    ),
    "unknown id": (lambda a: edit_instance(a, lambda i: i.update(urdf_id=7)), r"urdf/7: ", 3),
    "box off the image": (
        lambda a: edit_instance(a, lambda i: i.update(bbox=[700, 500, 720, 510])),
        rf"depth/{FILE}\.png: ",
        3,
    ),
    "points without numbers": (
        lambda a: a.points("2000000", 1).write_text("nan nan nan\n" * 20),
        r"1\.xyz: ",
        2,
    ),
    "points beyond all measure": (
        lambda a: a.points("2000000", 1).write_text("1e200 2 3\n4 5 6\n" * 200),
        r"1\.xyz: ",
        2,
    ),
    "few points": (lambda a: a.points("2000000", 1).write_text("1 2 3\n"), r"1\.xyz: ", 2),
    "rest state without a number": (
        lambda a: edit(a.rest_states, lambda r: r["2000000"]["1"].update(state=None)),
        r"rest_state\.json: .*part 1 .*2000000",
        2,
    ),
    "no urdf": (lambda a: a.aligned_urdf("2000000").unlink(), r"2000000/mobility_for_unity_align\.urdf: ", 2),
    "urdf cut off": (lambda a: cut(a.aligned_urdf("2000000")), r"align\.urdf: ", 2),
    "no points": (lambda a: a.points("2000000", 1).unlink(), r"part_point_sample/1\.xyz: ", 2),
    "points are words": (lambda a: a.points("2000000", 1).write_text("a b c"), r"part_point_sample/1\.xyz: ", 2),
    "no joint": (
        lambda a: a.aligned_urdf("2000000").write_text("<robot/>"),
        r"\[\].*\[1\]",
        2,
    ),
}  # fmt: skip


def edit_instance(layout: Layout, change: Callable[[dict], object]) -> None:
    edit(layout.annotation(f"{FILE}.json"), lambda record: change(record["instances"][0]))


@pytest.mark.slow
@pytest.mark.parametrize("case", BREAKING)
def test_broken_files_are_refused_or_skipped_by_name(case: str, laptops: Layout, capsys: pytest.CaptureFixture) -> None:
    break_it, message, left = BREAKING[case]
    break_it(laptops)
    with pytest.raises(InputError, match=message) as error:
        list(open_artimage(laptops.root, LAPTOP, "test"))
    assert "--broken skip" in str(error.value)
    assert "\n" not in str(error.value)
    images = open_artimage(laptops.root, LAPTOP, "test", broken="skip")
    assert len(list(images)) == left
    (listed,) = images.left_out
    assert listed["name"] in (f"{FILE}.json", "2000000", "7")
    assert f"left out {listed['name']}: {listed['reason']}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("camera_intrinsic.json", r"camera_intrinsic\.json: "),
        ("laptop/urdf/rest_state.json", r"rest_state\.json: "),
        ("laptop/test.txt", r"test\.txt: "),
    ],
)
def test_what_all_images_need_cannot_be_skipped(name: str, message: str, laptops: Layout) -> None:
    (laptops.root / name).unlink()
    for broken in ("refuse", "skip"):
        with pytest.raises(InputError, match=message):
            open_artimage(laptops.root, LAPTOP, "test", broken)
