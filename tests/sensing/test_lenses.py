"""Lenses: undone, as the drivers define them, read from files and from the command line."""

import json

import numpy as np
import pytest
from scipy.optimize import least_squares

from helpers.command_line import laptop_view
from helpers.lenses import BROWN, K, seen_through
from omad.applications.detection.detector import Detection
from omad.common.errors import InputError
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.lens import Distortion
from omad.sensing.camera_files import CameraFile, parse_distortion, read_camera
from omad.sensing.colour_mask import ColourCamera
from omad.sensing.input_options import FrameOptions, InputOptions
from omad.sensing.observation import Observation
from omad.sensing.reader import InputReader

LENSES = [
    Distortion("plumb_bob", BROWN),
    Distortion("rational_polynomial", (0.5, -2.6, 0.0007, -0.0003, 1.5, 0.4, -2.4, 1.4)),
    Distortion("inverse_brown_conrady", BROWN),
    Distortion("equidistant", (-0.01, 0.02, -0.03, 0.01)),
]


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_a_lens_is_undone(lens):
    rays = np.random.default_rng(0).uniform((-0.53, -0.4), (0.53, 0.4), (500, 2))
    seen = lens.distort(rays)
    assert np.abs(seen - rays).max() > 0.005
    assert np.allclose(lens.undistort(seen), rays, atol=1e-9)
    for place in seen[:20]:  # an independent solver agrees
        solved = least_squares(lambda ray, place=place: lens.distort(ray[None])[0] - place, place, xtol=1e-14)
        assert np.allclose(lens.undistort(place[None])[0], solved.x, atol=1e-7)


def test_beyond_its_fold_a_lens_shows_nothing():
    """With k1 = -0.3 rays r are seen at r - 0.3 r^3, at most 0.703, where r is 1.054; then it leads back."""
    lens = Distortion("plumb_bob", (-0.3, 0, 0, 0))
    assert lens.fold == pytest.approx(1 / np.sqrt(0.9), abs=1e-3)
    seen = np.array([[0.6, 0], [0, -0.69], [0.8, 0], [1.0, 0], [1.5, 0.1], [2.0, -2.0]])
    rays = lens.undistort(seen)
    assert np.isnan(rays).all(1).tolist() == [False, False, True, True, True, True]
    np.testing.assert_allclose(lens.distort(rays[:2]), seen[:2], atol=1e-9)
    assert Distortion("plumb_bob", (0.3, 0, 0, 0)).fold == np.inf


def test_a_rectified_image_has_no_ghosts_in_its_corners():
    camera = Camera(640, 480, 300, 300, 319.5, 239.5, Distortion("plumb_bob", (-0.3, 0, 0, 0)))
    rows, columns = np.mgrid[:480, :640]
    rays = camera.rays(np.stack([columns.ravel(), rows.ravel()], 1)).reshape(480, 640, 2)
    x, y = rays[..., 0], rays[..., 1]
    image = ((x > 0.4) & (x < 0.64) & (y > 0.3) & (y < 0.48)).astype(np.uint8)
    shown = np.argwhere(camera.rectified(image))
    np.testing.assert_allclose(shown.min(0), (239.5 + 300 * 0.3, 319.5 + 300 * 0.4), atol=1)
    np.testing.assert_allclose(shown.max(0), (239.5 + 300 * 0.48, 319.5 + 300 * 0.64), atol=1)


def test_what_a_wide_lens_shows_beyond_the_picture_is_left_out():
    """Undone, a fisheye's corners lie outside of an image of the same size."""
    wide, flat = Distortion("equidistant", (0.3,)), np.full((480, 640), 1.0)
    seen = Observation.from_depth(flat, K, distortion=wide)
    assert not seen.warnings
    with_corners = Observation.from_depth(flat, K, distortion=Distortion("equidistant", (-0.3,)))
    lost = 1 - len(with_corners.points) / flat.size
    assert with_corners.warnings[0].startswith(f"{lost:.0%} of the points lie outside")
    assert len(seen.points) > 0.5 * flat.size
    assert seen.part(np.arange(len(seen.points))).mask.sum() > 0.5 * flat.size
    assert seen.inside((0, 0, 640, 480)).all()
    with pytest.raises(InputError, match="distortion: without it 0 of 400 points"):
        Observation.from_depth(flat, K, box=(0, 0, 20, 20), distortion=Distortion("equidistant", (-0.3,)))


def test_the_models_are_those_of_the_drivers():
    """By hand, at (0.3, -0.2): r2 = 0.13."""
    x, y, r2 = 0.3, -0.2, 0.13
    k1, k2, p1, p2, k3 = BROWN
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    plain = (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
    )
    assert np.allclose(Distortion("brown_conrady", BROWN).distort(np.array([[x, y]]))[0], plain)
    assert np.allclose(Distortion("plumb_bob", BROWN[:4]).distort(np.array([[x, y]]))[0, 0], plain[0] - x * k3 * r2**3)
    a = np.arctan(np.sqrt(r2))
    fisheye = Distortion("equidistant", (0.1, 0.0, 0.0, 0.0)).distort(np.array([[x, y]]))[0]
    assert np.allclose(fisheye, np.array([x, y]) / np.sqrt(r2) * (a + 0.1 * a**3))
    assert np.allclose(STANDARD_CAMERA.project(np.array([[0.6, -0.4, 2.0]])), [[499.5, 119.5]])


def test_where_the_lens_shows_no_ray_there_is_none():
    seen = np.array([[2.0, 0.0], [0.1, 0.0]])  # a fisheye sees 90 degrees at 1.57
    rays = Distortion("equidistant", (0.0,)).undistort(seen)
    assert np.isnan(rays[0]).all()
    assert np.isfinite(rays[1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_points_and_picture_of_a_distorted_image_are_those_of_the_camera_without_its_lens(lens):
    view = laptop_view()
    plain = Observation.from_depth(view.depth, K)
    seen = Observation.from_depth(seen_through(lens, view.depth), K, distortion=lens)
    assert seen.depth is not None
    assert seen.mask is not None
    assert seen.pixels is not None
    assert plain.mask is not None
    assert np.allclose(seen.points.mean(0), plain.points.mean(0), atol=0.004)
    assert np.allclose(*(np.percentile(v.points, [1, 99], axis=0) for v in (seen, plain)), atol=0.005)
    assert (seen.mask & plain.mask).sum() / (seen.mask | plain.mask).sum() > 0.97
    both = (seen.depth > 0) & (view.depth > 0)
    assert np.median(np.abs(seen.depth - view.depth)[both]) < 0.002
    assert np.abs(STANDARD_CAMERA.project(seen.points) - seen.pixels).max() <= 0.51


def test_lenses_are_read_from_files(tmp_path):
    flat, listed = K.ravel().tolist(), list(BROWN)
    realsense = {"width": 640, "height": 480, "fx": 600, "fy": 600, "ppx": 319.5, "ppy": 239.5, "coeffs": listed}
    ros = f"image_width: 640\nimage_height: 480\ncamera_matrix: {{rows: 3, cols: 3, data: {flat}}}\n"
    forms = {
        "a.json": (json.dumps({**realsense, "model": "Inverse Brown Conrady"}), "inverse_brown_conrady"),
        "b.json": (json.dumps({**realsense, "model": "distortion.brown_conrady"}), "brown_conrady"),
        "c.json": (json.dumps({**realsense, "model": 2}), "inverse_brown_conrady"),
        "d.yaml": (ros + f"distortion_model: plumb_bob\ndistortion_coefficients: {{data: {listed}}}\n", "plumb_bob"),
        "e.yaml": (f"height: 480\nwidth: 640\nK: {flat}\nD: {listed}\n---\n", "plumb_bob"),
        "f.yaml": (f"k: {flat}\nd: {listed[:4]}\ndistortion_model: equidistant\n", "equidistant"),
        "g.json": (json.dumps({**realsense, "model": "none"}), None),
        "h.json": (json.dumps({**realsense, "coeffs": [0] * 5, "model": "Brown Conrady"}), None),
        "i.json": (json.dumps({**realsense, "model": None}), "plumb_bob"),
    }
    for name, (content, model) in forms.items():
        (tmp_path / name).write_text(content)
        camera = read_camera(tmp_path / name)
        assert np.allclose(camera.K, K)
        assert (None if camera.distortion is None else camera.distortion.model) == model, name
        assert camera.size in ((640, 480), None)
        if camera.distortion is not None:
            assert camera.distortion.coefficients == BROWN[: len(camera.distortion.coefficients)]
    P = [500, 0, 300, 9, 0, 510, 200, 0, 0, 0, 1, 0]
    (tmp_path / "p.yaml").write_text(f"K: {flat}\nD: {listed}\nP: {P}\n")
    options = InputOptions(intrinsics=str(tmp_path / "p.yaml"))
    for frame, focal, lens in ((FrameOptions(), 600, "plumb_bob"), (FrameOptions(distortion="none"), 500, None)):
        seen = InputReader.of(options, [], frame).observe(np.ones((480, 640), np.float32), None)
        assert seen.camera.fx == focal, lens
    assert read_camera("600,600,319.5,239.5").distortion is None
    for content, word in (
        (json.dumps({**realsense, "model": "F-Theta"}), "f_theta"),
        (json.dumps({**realsense, "model": -1}), "its lens"),
        (json.dumps({**realsense, "coeffs": "many", "model": "Brown Conrady"}), "coeffs"),
        (json.dumps({**realsense, "coeffs": [1.0] * 12, "model": "Brown Conrady"}), "8"),
    ):
        (tmp_path / "bad.json").write_text(content)
        with pytest.raises(InputError, match=word) as error:
            read_camera(tmp_path / "bad.json")
        assert "bad.json" in str(error.value)
        assert "\n" not in str(error.value)


def test_coefficients_of_a_lens_may_have_names(tmp_path):
    flat = {"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5}
    file = tmp_path / "camera.json"
    for told, model in (
        (dict(zip(("k1", "k2", "p1", "p2", "k3"), BROWN, strict=True)), "plumb_bob"),
        (dict(zip(("k1", "k2", "k3", "k4"), BROWN, strict=False)) | {"model": "fisheye"}, "equidistant"),
    ):
        file.write_text(json.dumps(flat | told))
        found = read_camera(file).distortion
        assert found is not None
        assert found.model == model
        assert found.coefficients[:4] == BROWN[:4]
        assert not any(found.coefficients[5:])
    file.write_text(json.dumps(flat | dict.fromkeys(("k1", "k2", "k3", "k4"), 0.1)))
    with pytest.raises(InputError, match="distortion_model"):
        read_camera(file)


@pytest.mark.parametrize(
    "key", ["dist_coeffs", "dist_coeff", "distCoeffs", "dist", "disto", "distortion", "distortion_parameters", "D"]
)
def test_coefficients_are_found_under_every_name_and_beside_a_table_of_intrinsics(tmp_path, key):
    flat, file, named = {"fx": 600, "fy": 600, "cx": 319.5, "cy": 239.5}, tmp_path / "camera.json", ("k1", "k2")
    size, listed = {"width": 640, "height": 480}, [*BROWN]
    for told in (listed, [listed], {"data": listed, "rows": 1, "cols": 5}, {"model": "plumb_bob", "coeffs": listed}):
        for table in (
            flat | {key: told},
            {"intrinsics": flat, key: told, **size},
            {"camera": flat | {key: told}} | size,
        ):
            file.write_text(json.dumps(table))
            assert read_camera(file).distortion == Distortion("plumb_bob", BROWN)
    assert read_camera(file).size == (640, 480)
    file.write_text(json.dumps({"intrinsic": flat, key: dict(zip(named, BROWN, strict=False))}))
    found = read_camera(file).distortion
    assert found is not None
    assert found.coefficients[:3] == (*BROWN[:2], 0.0)
    for none in ({key: None}, {key: [0.0] * 5}, {"distance": [1.0, 2.0]}):
        file.write_text(json.dumps(flat | none))
        assert read_camera(file).distortion is None
    file.write_text(json.dumps({"depth": flat, "color": flat, key: listed}))
    assert read_camera(file).distortion is None  # it may be of the colour camera


@pytest.mark.parametrize("names", [("K", "D"), ("camera_matrix", "dist_coeffs"), ("mtx", "dist")])
def test_an_npz_tells_of_camera_and_lens(tmp_path, names):
    image = np.ones((480, 640), np.float32)
    arrays = {names[0]: STANDARD_CAMERA.K, names[1]: np.array([BROWN]), "depth": image}
    np.savez(tmp_path / "camera.npz", **arrays)
    if names[0] == "mtx":
        with pytest.raises(InputError, match=r"camera\.npz: holds no intrinsics; expected"):
            read_camera(tmp_path / "camera.npz")
        return
    found = read_camera(tmp_path / "camera.npz")
    np.testing.assert_array_equal(found.K, STANDARD_CAMERA.K)
    assert found.distortion == Distortion("plumb_bob", BROWN)
    np.savez(tmp_path / "alone.npz", anything=STANDARD_CAMERA.K)
    np.testing.assert_array_equal(read_camera(tmp_path / "alone.npz").K, STANDARD_CAMERA.K)


def test_a_fisheye_of_instant_ngp_is_one(tmp_path):
    told = {"fl_x": 300, "fl_y": 300, "cx": 320, "cy": 240, "w": 640, "h": 480, "is_fisheye": True}
    told |= dict(zip(("k1", "k2", "k3", "k4", "p1", "p2"), (0.03, -0.01, 0.0, 0.002, 0.0, 0.0), strict=True))
    (tmp_path / "transforms.json").write_text(json.dumps(told))
    found = read_camera(tmp_path / "transforms.json")
    assert found.distortion == Distortion("equidistant", (0.03, -0.01, 0.0, 0.002))
    assert found.size == (640, 480)


def test_what_lies_beyond_a_colour_cameras_fold_is_not_in_its_image():
    """A plate at 1 m in a wide depth image, what is nearer at its edges, where a colour camera's lens folds back."""
    wide, lens = Camera(640, 480, 250, 250, 319.5, 239.5), Distortion("plumb_bob", (-0.3, 0, 0, 0))
    depth = np.zeros((480, 640))
    depth[180:300, 260:380] = 1.0
    depth[:, :20] = depth[:, -20:] = 0.7
    seen = ColourCamera(CameraFile(Camera(640, 480, 300, 300, 319.5, 239.5).K, lens, (640, 480)), np.eye(4))
    chosen = seen.depth_mask(depth, wide, np.ones((480, 640), bool), None)
    np.testing.assert_array_equal(chosen, depth == 1.0)
    assert not seen.seen_from_depth(depth, wide, np.full((480, 640, 3), 9, np.uint8))[:, :20].any()


def test_coefficients_may_be_any_list_of_numbers():
    assert Distortion("plumb_bob", np.float32([0.5, 0.25, 0, 0])) == Distortion("plumb_bob", (0.5, 0.25, 0.0, 0.0))
    assert len({Distortion("plumb_bob", [0.5, 0, 0, 0]), Distortion("plumb_bob", (0.5, 0, 0, 0))}) == 1
    for wrong in (("a",), None, ((1, 2), (3,)), [[0.1]], [np.inf], 0.1):
        with pytest.raises(InputError, match="give at most 8 finite numbers"):
            Distortion("plumb_bob", wrong)


def test_lenses_are_read_from_the_command_line():
    assert parse_distortion("none") is None
    assert parse_distortion("0.1,-0.2,0,0,0.05") == Distortion("plumb_bob", (0.1, -0.2, 0, 0, 0.05))
    assert parse_distortion("equidistant: 0.1,0,0,0") == Distortion("equidistant", (0.1, 0, 0, 0))
    for text in ("0.1,0.2", "x", "oval:1,2", "nan,0,0,0"):
        with pytest.raises(InputError) as error:
            parse_distortion(text)
        assert "\n" not in str(error.value)


def test_a_mask_of_a_colour_camera_in_the_same_place_is_that_of_depth():
    depth, mask = np.full((120, 160), 1.5), np.zeros((120, 160), bool)
    mask[:, [11, 77, 150]] = True
    K = np.array([[83.0, 0, 79.3], [0, 83, 59.6], [0, 0, 1]])
    same = ColourCamera(CameraFile(K, None, (160, 120)), np.eye(4))
    assert np.array_equal(same.depth_mask(depth, Camera.from_K(K, 160, 120), mask, None), mask)


def test_boxes_are_of_the_image_that_was_given():
    lens, depth = Distortion("equidistant", (0.0,)), np.full((120, 160), 2.0, np.float32)
    depth[:, ::2] = 1.5
    K, box = np.array([[80.0, 0, 79.5], [0, 80, 59.5], [0, 0, 1]]), (100, 30, 150, 90)
    whole = Observation.from_depth(depth, K, distortion=lens)
    asked = Observation.from_depth(depth, K, box=box, distortion=lens)
    inside = whole.inside(box)
    np.testing.assert_array_equal(whole.points[inside], asked.points)
    there = whole.part(inside)
    assert Detection(there, {}, None, {}).box == Detection(asked, {}, None, {}).box
    assert np.abs(there.given_pixels - there.pixels).max() > 5
    np.testing.assert_array_equal(there.mirrored().given_pixels, there.given_pixels * [-1, 1] + [159, 0])
