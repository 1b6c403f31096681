"""What lies beside a depth image is read, and intrinsics that cannot be right are told of."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from scipy.spatial.transform import Rotation

from helpers.command_line import LAPTOP, K, answer, laptop_view, refused, save_png
from omad.cli.main import run
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view
from omad.estimation.checks import camera_doubts, gravity_doubts, scale_doubts, scaled
from omad.estimation.estimator import Estimator
from omad.estimation.known import Known
from omad.objects.category_file import get_category
from omad.sensing.beside import Beside, is_companion
from omad.sensing.camera_files import scale_of
from omad.sensing.cutting.angles import angle_doubts
from omad.sensing.input_options import InputOptions
from omad.sensing.observation import Observation
from omad.sensing.reader import InputReader


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def rendered(capsys, *options: str) -> tuple[str, float]:
    """The first image that ``omad render`` writes, and its true joint state."""
    assert run(["render", *LAPTOP, "--output", "views", "--views", "1", "--objects", "1", *options]) == 0
    capsys.readouterr()
    image = next(Path("views").glob("*/00000.depth.png"))
    return str(image), json.loads(image.with_name("00000.json").read_text())["states"][0]


@pytest.mark.parametrize("options", [[], ["--clutter"]], ids=["standard", "clutter"])
def test_a_rendered_image_needs_no_options(options, capsys):
    image, truth = rendered(capsys, *options)
    found = answer(capsys, "estimate", image, *LAPTOP)
    assert abs(np.degrees(found["joints"][0]["state"] - truth)) < 8
    assert found["warnings"] == []
    assert answer(capsys, "estimate", str(Path(image).parent), *LAPTOP)["refused"] == []  # labels are no depth images


def test_a_folder_of_views_is_one_of_masks_and_no_image_is_its_own_mask(capsys):
    image, _ = rendered(capsys, "--clutter")
    folder, lone = Path(image).parent, Path("depth")
    mask = folder / "00000.mask.png"
    cut_out = InputReader.of(InputOptions(mask=mask), [Path(image)])(Path(image))
    for masks in (folder, folder.absolute()):
        named_alike = InputReader.of(InputOptions(mask=masks), [Path(image)])(Path(image))
        assert np.array_equal(named_alike.points, cut_out.points)
    lone.mkdir()
    shutil.copy(image, lone / "a.png")
    for options, said in (
        (["--mask", str(lone)], "no mask for"),
        (["--color", str(lone)], "no color for"),
        (["--mask", str(lone / "a.png")], "is the depth image itself; give its mask"),
    ):
        assert said in refused(capsys, "estimate", str(lone / "a.png"), *LAPTOP, *K, *options)


def test_a_scale_that_contradicts_the_folders_own_is_told_and_named_without_a_mask(capsys):
    image, _ = rendered(capsys)
    assert run(["estimate", image, *LAPTOP, *K, "--depth-scale", "0.001", "--json"]) == 0
    told = capsys.readouterr()
    assert "dataset.json tells 0.0001" in told.err
    found = json.loads(told.out)
    size = next(check for check in found["checks"] if check["name"] == "size")
    assert "10 times too large" in size["why"]
    assert "--depth-scale 0.0001" in size["cure"]
    assert not any(check["name"] == "category" for check in found["checks"])
    shutil.copy(image, "alone.png")
    found = answer(capsys, "estimate", "alone.png", *LAPTOP, *K)
    assert "--depth-scale 0.0001" in next(check for check in found["checks"] if check["name"] == "size")["cure"]
    # points that are all far from each other for a category give an answer that nobody believes
    found = answer(capsys, "estimate", "alone.png", "--category", "scissors", *K)
    assert found["doubtful"]
    assert found["probability"] < 0.1
    assert "--depth-scale 0.0001" in next(check for check in found["checks"] if check["name"] == "size")["cure"]


def test_a_camera_beside_an_image_is_read(capsys):
    save_png("depth.png")
    assert "camera.json" in refused(capsys, "estimate", "depth.png", *LAPTOP)
    told = {"width": 640, "height": 480, "fx": 600, "fy": 600, "ppx": 319.5, "ppy": 239.5, "depth_scale": 1000.0}
    matrix = laptop_view().camera.K.tolist()
    Path("camera.json").write_text(json.dumps(matrix))
    beside = Beside.of(Path("depth.png")).camera
    assert beside is not None
    assert beside.K.tolist() == matrix
    Path("camera.json").write_text(json.dumps(told))
    assert Beside.of(Path("depth.png")).depth_scale == pytest.approx(0.001)
    found = answer(capsys, "estimate", "depth.png", *LAPTOP)
    assert abs(found["joints"][0]["state"] - laptop_view().states[0]) < 0.1
    assert run(["estimate", "depth.png", *LAPTOP, "--intrinsics", "500,500,319.5,239.5"]) == 0
    assert "camera.json tells 600" in capsys.readouterr().err
    Path("depth.json").write_text(json.dumps(told | {"width": 1280, "height": 720}))  # the image's own comes first
    told = refused(capsys, "estimate", "depth.png", *LAPTOP)
    assert "depth.png: the image is 640x480, but the camera of depth.json is for 1280x720; give --intrinsics" in told


def test_a_scale_beside_an_image_is_of_its_integers():
    Path("camera.json").write_text(json.dumps({"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "depth_scale": 0.00025}))
    stored = np.full((48, 64), 4000, dtype=np.uint16)
    Image.fromarray(stored).save("image.png")
    np.save("integers.npy", stored)
    Image.fromarray(np.ones((48, 64), dtype=np.float32)).save("metres.tiff")
    np.save("channel.npy", stored[None])
    for name in ("image.png", "integers.npy", "channel.npy", "metres.tiff"):
        reader = InputReader.of(InputOptions(), [Path(name)])
        assert reader(Path(name)).points[:, 2] == pytest.approx(1.0)


def test_a_scale_in_the_text_of_a_png_is_of_its_integers(capsys):
    stored, told = Image.fromarray(np.full((9, 9), 7000, np.uint16)), PngInfo()
    told.add_text("depth_scale", "1e-4")
    stored.save("depth.png", pnginfo=told)
    seen = InputReader.of(InputOptions(intrinsics="9,9,4,4"), [Path("depth.png")])(Path("depth.png"))
    assert np.allclose(seen.points[:, 2], 0.7)
    Path("depth.json").write_text('{"depth_scale": 0.001}')
    assert (Beside.of(Path("depth.png")).depth_scale, Beside.of(Path("depth.tif")).depth_scale) == (0.001, 0.001)
    Path("depth.json").unlink()
    told.add_text("depth_scale", "millimetres")
    stored.save("depth.png", pnginfo=told)
    with pytest.raises(InputError, match=r"depth\.png: depth_scale is no number"):
        Beside.of(Path("depth.png"))


def test_of_a_camera_of_another_size_the_scaled_one_is_named():
    np.save("depth.npy", np.ones((8, 12)))
    camera = {"fx": 50, "fy": 52, "cx": 5.5, "cy": 3.5}
    cures = {
        (24, 16): r"only scaled that is --intrinsics 25,26,2\.5,1\.5",
        (8, 12): "back by 90 degrees",
        (12, 7): "this size$",
    }
    for (width, height), cure in cures.items():
        Path("depth.json").write_text(json.dumps({**camera, "width": width, "height": height}))
        with pytest.raises(InputError, match=f"is 12x8, .* is for {width}x{height}; give --intrinsics of .*{cure}"):
            InputReader.of(InputOptions(), [Path("depth.npy")])(Path("depth.npy"))


def test_a_scale_in_the_file_of_the_intrinsics_is_that_of_the_images():
    told = {"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "depth_scale": 4000}
    Path("calibration.json").write_text(json.dumps(told))
    Image.fromarray(np.full((48, 64), 4000, dtype=np.uint16)).save("image.png")
    named = InputOptions(intrinsics="calibration.json")
    assert InputReader.of(named, [])(Path("image.png")).points[:, 2] == pytest.approx(1.0)
    scaled = InputReader.of(replace(named, depth_scale=0.0005), [])
    assert scaled(Path("image.png")).points[:, 2] == pytest.approx(2.0)
    Path("camera.json").write_text('{"depth_scale": 0.001}')
    seen = InputReader.of(named, [])(Path("image.png"))
    assert seen.points[:, 2] == pytest.approx(1.0)
    assert "depth_scale of --intrinsics is 0.00025, but camera.json tells 0.001" in seen.warnings[-1]


def test_cameras_of_all_images_of_a_bop_scene():
    cameras = {str(n): {"cam_K": [60 + n, 0, 31.5, 0, 60 + n, 23.5, 0, 0, 1], "depth_scale": 0.1} for n in (0, 7)}
    Path("depth").mkdir()
    Path("scene_camera.json").write_text(json.dumps(cameras))
    for number in (0, 7):
        image = Path(f"depth/{number:06d}.png")
        Image.fromarray(np.full((48, 64), 10000, dtype=np.uint16)).save(image)
        seen = InputReader.of(InputOptions(), [image])(image)
        assert seen.points[:, 2] == pytest.approx(1.0)  # 0.1 millimetres a number
        assert seen.camera is not None
        assert seen.camera.fx == 60 + number
    with pytest.raises(InputError, match="camera for each of 2 images; leave --intrinsics out"):
        InputReader.of(InputOptions(intrinsics="scene_camera.json"), [image])
    Path("same.json").write_text(json.dumps({"0": cameras["7"], "7": cameras["7"]}))
    assert InputReader.of(InputOptions(intrinsics="same.json"), [image])(image).points[:, 2] == pytest.approx(1.0)
    for stored, metres in (
        (1.0, 0.001),
        (0.1, 0.0001),
        (0.001, 0.001),
        (1000, 0.001),
        (0.00025, 0.00025),
        ("1e-4", 1e-4),
    ):
        assert scale_of({"depth_scale": stored}, "a.json") == pytest.approx(metres)
        for kept in ("depth", "camera", "intrinsics"):  # where the camera is
            assert scale_of({kept: {"fx": 60, "depth_scale": stored}}, "a.json") == pytest.approx(metres)


def test_a_mask_in_the_file_of_the_depth_image_counts():
    depth, mask = np.full((48, 64), 0.9, np.float32), np.zeros((48, 64), bool)
    mask[10:30, 20:40] = True
    np.savez("view.npz", depth=depth, mask=mask)
    options = InputOptions(intrinsics="60,60,31.5,23.5")
    assert len(InputReader.of(options, [Path("view.npz")])(Path("view.npz")).points) == mask.sum()
    boxed = InputReader.of(InputOptions(intrinsics="60,60,31.5,23.5", box="0,0,48,48"), [Path("view.npz")])
    assert len(boxed(Path("view.npz")).points) > mask.sum()  # what is asked for goes before


def test_of_a_label_image_beside_one_the_object_is_named():
    save_png("depth.png")
    labels = np.zeros((480, 640), dtype=np.uint8)
    labels[laptop_view().depth > 0] = 3
    labels[:10] = 1
    Image.fromarray(labels).save("depth.mask.png")
    seen = InputReader.of(InputOptions(intrinsics="600,600,319.5,239.5", mask_id=3), [Path("depth.png")])(
        Path("depth.png")
    )
    assert len(seen.points) == np.count_nonzero(laptop_view().depth > 0)


def test_other_files_beside_an_image_are_passed_over():
    save_png("depth.png")
    Path("depth.json").write_text('{"joints": []}')
    Path("camera.json").write_text("{")
    assert Beside.of(Path("depth.png")) == Beside()
    assert is_companion(Path("00000.labels.png"))
    assert not is_companion(Path("00000.depth.png"))


@pytest.mark.parametrize("centre", ["160,120", "424,239.5", "320,120"])
def test_a_principal_point_of_another_size_is_told(centre, capsys):
    assert run(["estimate", save_png("depth.png"), *LAPTOP, "--intrinsics", f"600,600,{centre}"]) == 0
    assert "principal point" in capsys.readouterr().err


def test_a_focal_length_that_the_object_does_not_fit_is_told(capsys):
    def told(focal: int) -> list[str]:
        camera = ["--intrinsics", f"{focal},{focal},319.5,239.5"]
        checks = answer(capsys, "estimate", save_png("depth.png"), *LAPTOP, *camera)["checks"]
        return [check["what"] for check in checks if check["name"] == "intrinsics"]

    for focal in (900, 400):
        [what] = told(focal)
        assert "about 600 instead" in what
    assert told(600) == []


def room(pitch: float) -> np.ndarray:
    """Depth (240, 320) of a floor 1 m below and a wall 3 m before a camera, f = 300, that looks down by ``pitch``."""
    v, u = np.mgrid[:240, :320]
    rays = np.stack([(u - 159.5) / 300, (v - 119.5) / 300, np.ones(u.shape)], -1)
    c, s = np.cos(pitch), np.sin(pitch)
    down, forth = rays @ [0, c, s], rays @ [0, -s, c]
    with np.errstate(divide="ignore"):
        return np.minimum(np.where(down > 0, 1 / down, np.inf), np.where(forth > 0, 3 / forth, np.inf))


def test_planes_that_are_not_at_right_angles_tell_the_focal_length():
    depth = room(np.radians(25))
    depth[100:140, 140:180] = 1.5  # a thing before them
    right = Observation.from_depth(depth, (300, 300, 159.5, 119.5), segment="plane")
    wrong = Observation.from_depth(depth, (450, 450, 159.5, 119.5), segment="plane")
    assert not [text for text in right.warnings if "planes" in text]
    told = next(text for text in wrong.warnings if "planes" in text)
    assert "focal length 0.67 times" in told
    assert angle_doubts(np.array([[0, -1, 0, -1.0]])) == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["laptop", "dishwasher", "drawer"])
def test_right_focal_lengths_are_hardly_ever_doubted(name):
    estimator, category = Estimator.from_pretrained(name), get_category(name)
    doubted = []
    for i in range(10):
        view = standard_view(generate(category, 50 + i, "test"), category, (7, i), LEVELS["on"])
        seen = view.observation()
        doubted.append(bool(camera_doubts(seen, estimator(seen), estimator.first_answers)))
    assert np.mean(doubted) <= 0.1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["laptop", "eyeglasses", "drawer"])
def test_depth_scales_of_other_cameras_are_named_where_the_size_does_not_tell_of_them(name):
    """Those of a RealSense L515 and of TUM's data sets, for that of the right camera, which is not doubted."""
    estimator, category = Estimator.from_pretrained(name), get_category(name)
    named = {0.00025: 0, 0.0002: 0, 0.001: 0}
    for i in range(8):
        view = standard_view(generate(category, 50 + i, "test"), category, (7, i), LEVELS["on"])
        for right in named:
            seen = scaled(view.observation(), 0.001 / right)
            found = scale_doubts(seen, estimator(seen), estimator.first_answers, 0.001)
            named[right] += any("--depth-scale 0.0002 or 0.00025, " in check.cure for check in found)
            assert len(found) <= 1
    assert named[0.00025] >= 6
    assert named[0.0002] >= 6
    assert named[0.001] == 0


@pytest.mark.parametrize("turned_by", [90, 180])
def test_of_a_turned_camera_the_right_gravity_is_believed_and_a_level_ones_wrong_one_is_not(turned_by):
    estimator, category = Estimator.from_pretrained("refrigerator"), get_category("refrigerator")
    T = Rotation.from_euler("z", turned_by, degrees=True).as_matrix()
    right, wrong = [], []
    for i in range(5):
        view = standard_view(generate(category, 60 + i, "test"), category, (8, i), LEVELS["on"])
        seen = view.observation()
        turned, known = Observation.from_points(seen.points @ T.T), Known(gravity=-T @ view.T_camera_base[:3, 1])
        for observation, doubted in ((turned, right), (seen, wrong)):
            found = estimator(observation, known)
            doubted.append(bool(gravity_doubts(observation, found, known, estimator)))
    assert sum(right) <= 1
    assert sum(wrong) >= 4


@pytest.mark.parametrize("name", ["laptop", "drawer"])
def test_gravity_that_the_object_contradicts_is_doubted_and_the_right_one_is_not(name):
    estimator, category = Estimator.from_pretrained(name), get_category(name)
    right, wrong = [], []
    for i in range(10):
        view = standard_view(generate(category, 50 + i, "test"), category, (7, i), LEVELS["on"])
        seen, down = view.observation(), -view.T_camera_base[:3, 1]
        aside = np.cross(down, [0.0, 0.0, 1.0])
        for gravity, doubted in ((down, right), (down + np.tan(np.radians(18)) * aside / np.linalg.norm(aside), wrong)):
            known = Known(gravity=gravity)
            doubted.append(bool(gravity_doubts(seen, estimator(seen, known), known, estimator)))
    assert sum(right) <= 1
    assert sum(wrong) >= 9
