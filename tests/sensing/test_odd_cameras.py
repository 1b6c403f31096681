"""Cameras that cannot be those of the image, or are unlike what lies beside it: each is named."""

import json
from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import LAPTOP, answer, refused, save_png
from helpers.tabletop import laptop_view, on_a_table
from omad.common.errors import InputError
from omad.geometry.camera import STANDARD_CAMERA
from omad.objects.category_file import get_category
from omad.objects.sizes import WrongScale, usual_size, wrong_scale
from omad.sensing.input_options import FrameOptions, InputOptions
from omad.sensing.observation import Observation
from omad.sensing.reader import InputReader

TOLD = {"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5}


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def warnings_of(intrinsics: str) -> tuple[str, ...]:
    return InputReader.of(InputOptions(intrinsics=intrinsics), [Path("depth.png")])(Path("depth.png")).warnings


def test_each_number_is_compared_with_the_camera_beside_the_image():
    save_png("depth.png")
    Path("camera.json").write_text(json.dumps(TOLD))
    assert not warnings_of("601,599,320,240")
    for intrinsics, told in (
        ("650,600,319.5,239.5", "fx of --intrinsics is 650, but camera.json tells 600"),
        ("600,650,319.5,239.5", "fy of --intrinsics is 650, but camera.json tells 600"),
        ("600,600,340,239.5", "cx of --intrinsics is 340, but camera.json tells 319.5"),
        ("600,600,319.5,250", "cy of --intrinsics is 250, but camera.json tells 239.5"),
    ):
        [warning] = warnings_of(intrinsics)
        assert warning.startswith(told)


def test_focal_lengths_of_pixels_that_are_not_square_are_told():
    seen = Observation.from_depth(laptop_view().depth, (600, 400, 319.5, 239.5))
    [warning] = seen.warnings
    assert warning.startswith("fx is 600 and fy 400")
    assert not Observation.from_depth(laptop_view().depth, (600, 590, 319.5, 239.5)).warnings


def test_intrinsics_in_shares_of_the_image_are_refused():
    shares = STANDARD_CAMERA.K / [[640], [480], [1]]
    with pytest.raises(InputError, match=r"fx 0.9375 and fy 1.25 are no pixels of a 640x480 image.*times its width"):
        Observation.from_depth(laptop_view().depth, shares)
    save_png("depth.png")
    with pytest.raises(InputError, match=r"depth\.png: intrinsics: fx 0.9"):
        warnings_of("0.9375,1.25,0.5,0.5")


@pytest.mark.parametrize(("times", "doubted"), [(2.0, True), (0.5, True), (1.0, False)])
def test_intrinsics_of_another_size_of_the_image_are_never_believed(times, doubted, capsys):
    save_png("depth.png")
    K = f"{600 * times},{600 * times},{320 * times - 0.5},{240 * times - 0.5}"
    found = answer(capsys, "estimate", "depth.png", *LAPTOP, "--intrinsics", K)
    checks = {check["name"]: check for check in found["checks"]}
    assert ("intrinsics" in checks) == doubted
    assert found["doubtful"] == doubted
    assert not doubted or "only scaled 600,600,319.5,239.5" in checks["intrinsics"]["cure"]


def test_a_plane_of_what_was_cut_out_already_is_told_of():
    seen = Observation.from_depth(laptop_view().depth, STANDARD_CAMERA, segment="plane")
    assert any("may be the object's own" in warning for warning in seen.warnings)
    scene, _ = on_a_table()
    seen = Observation.from_depth(scene, STANDARD_CAMERA, segment="plane")
    assert not any("may be the object's own" in warning for warning in seen.warnings)


def test_a_colour_camera_in_millimetres_is_refused(capsys):
    save_png("depth.png")
    T = np.eye(4)
    T[0, 3] = 15.0
    np.savetxt("apart.txt", T)
    camera = ["--color-intrinsics", "920,920,640,360", "--color-extrinsics", "apart.txt"]
    options = ["estimate", "depth.png", *LAPTOP, "--intrinsics", "600,600,319.5,239.5", "--box", "1,1,99,99", *camera]
    assert "apart.txt: T_color_depth moves by 15 m; give its translation in metres" in refused(capsys, *options)


def test_colours_of_a_cloud_are_refused():
    np.save("cloud.npy", Observation.from_depth(laptop_view().depth, STANDARD_CAMERA).points)
    frame = FrameOptions(color=Path("colours"))
    Path("colours").mkdir()
    with pytest.raises(InputError, match=r"cloud\.npy: --color and --color-intrinsics need a depth image"):
        InputReader.of(InputOptions(), [Path("cloud.npy")], frame)(Path("cloud.npy"))


def test_scales_that_no_size_tells_apart_are_named_together():
    usual = usual_size(get_category("laptop"))
    found = wrong_scale(4.5 * usual, usual, 0.001)
    assert found == WrongScale("depth looks like lengths 5 or 4 times too large", "--depth-scale 0.0002 or 0.00025")
    assert wrong_scale(1000 * usual, usual) == WrongScale(
        "depth looks like millimetres read as metres", "multiply the depth scale by 0.001"
    )
