"""A frame of one's own camera: its colour camera, its place in the world, and doubtful results."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_closing

from helpers.command_line import LAPTOP, answer, refused, save_png
from helpers.command_line import K as K_OPTION
from helpers.lenses import BROWN, K, seen_through
from helpers.pages import blocks
from helpers.tabletop import cloud_of, laptop_view, on_a_table
from omad.cli.main import run
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS, add_noise
from omad.data.rendering.standard_views import standard_view
from omad.estimation.categories.ranking import rank, suspected
from omad.estimation.checks import doubts, gravity_doubts, size_doubts
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.estimation.known import Known
from omad.estimation.world import gravity_in_camera, in_world
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.lens import Distortion
from omad.geometry.rigid import carry
from omad.objects.category_file import get_category
from omad.sensing.camera_files import CameraFile, read_transform
from omad.sensing.colour_mask import ColourCamera
from omad.sensing.observation import Observation


@cache
def shared_estimator(name: str = "laptop") -> Estimator:
    return Estimator.from_pretrained(name)


@cache
def laptop_observation() -> Observation:
    return Observation.from_depth(laptop_view().depth, K)


@cache
def laptop_estimate() -> Estimate:
    return shared_estimator()(laptop_observation())


# depth beside colour


T_COLOR_DEPTH = np.array([[0.9998, -0.0175, 0.01, 0.015], [0.0175, 0.9998, 0.0, 0.002], [-0.01, 0.0002, 1.0, -0.004]])
COLOR_K = np.array([[920.0, 0, 640], [0, 920, 360], [0, 0, 1]])
COLOR_LENS = Distortion("brown_conrady", (0.15, -0.4, 0.001, 0.0005, 0.3))


def rigid(approximate: np.ndarray) -> np.ndarray:
    u, _, v = np.linalg.svd(approximate[:, :3])
    return np.vstack([np.c_[u @ v, approximate[:, 3]], [0, 0, 0, 1]])


def color_mask(points: np.ndarray) -> np.ndarray:
    """(720, 1280) bool, where the colour camera sees points (N, 3) of the depth camera's frame."""
    pixels = Camera.from_K(COLOR_K, 1280, 720, COLOR_LENS).project(carry(rigid(T_COLOR_DEPTH), points))
    mask = np.zeros((720, 1280), dtype=bool)
    column, row = np.rint(pixels).astype(int).T
    inside = (column >= 0) & (column < 1280) & (row >= 0) & (row < 720)
    mask[row[inside], column[inside]] = True
    return binary_closing(mask, iterations=3)


def colour_camera() -> ColourCamera:
    return ColourCamera(CameraFile(COLOR_K, COLOR_LENS, (1280, 720)), rigid(T_COLOR_DEPTH))


def test_a_mask_of_the_colour_image_chooses_the_objects_depth():
    scene, truth = on_a_table()
    chosen = colour_camera().depth_mask(scene, STANDARD_CAMERA, color_mask(cloud_of(np.where(truth, scene, 0))), None)
    assert (chosen & truth).sum() > 0.97 * truth.sum()
    assert (chosen & ~truth).sum() < 0.04 * truth.sum()


def test_what_the_colour_camera_cannot_see_is_left_out():
    """A plate before a wall: seen from beside, the plate hides another piece of the wall."""
    depth = np.full((480, 640), 1.5)
    depth[140:340, 220:420] = 0.5
    T = np.eye(4)
    T[0, 3] = 0.1
    everything = np.ones((720, 1280), dtype=bool)
    chosen = ColourCamera(CameraFile(COLOR_K, None, None), T).depth_mask(depth, STANDARD_CAMERA, everything, None)
    assert chosen[150:330, 230:410].all()
    hidden = chosen[150:330, 422 : 420 + 78]  # (0.1 / 0.5 - 0.1 / 1.5) * 600 = 80 pixels
    assert hidden.mean() < 0.1
    assert chosen[150:330, 510:].all()
    assert chosen[150:330, :210].all()
    box = ColourCamera(CameraFile(COLOR_K, None, None), T).depth_mask(depth, STANDARD_CAMERA, None, (0, 0, 640, 720))
    assert 0 < box.sum() < chosen.sum()


def test_a_box_of_the_colour_image_is_one_around_what_it_shows():
    scene, truth = on_a_table()
    rows, columns = np.nonzero(color_mask(cloud_of(np.where(truth, scene, 0))))
    around = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    left, top, right, bottom = colour_camera().depth_box(scene, STANDARD_CAMERA, around)
    inside = colour_camera().depth_mask(scene, STANDARD_CAMERA, None, around)
    assert inside[top:bottom, left:right].sum() == inside.sum()
    assert all(edge.any() for edge in (inside[top], inside[bottom - 1], inside[:, left], inside[:, right - 1]))
    assert truth[top:bottom, left:right].sum() > 0.99 * truth.sum()
    with pytest.raises(InputError, match=r"^box: .*colour image"):
        colour_camera().depth_box(np.zeros_like(scene), STANDARD_CAMERA, around)


@pytest.mark.filterwarnings("error")
def test_what_is_infinitely_far_is_no_measurement_beside_a_colour_camera():
    depth = np.full((480, 640), 1.5)
    depth[:40] = np.inf
    camera = ColourCamera(CameraFile(COLOR_K, None, (1280, 720)), rigid(T_COLOR_DEPTH))
    assert not camera.depth_mask(depth, STANDARD_CAMERA, np.ones((720, 1280), bool), None)[:40].any()
    assert not camera.seen_from_depth(depth, STANDARD_CAMERA, np.ones((720, 1280, 3), np.uint8))[:40].any()


@pytest.mark.parametrize("end", [np.nan, np.inf, 1e6])
def test_a_box_that_no_colour_image_holds_is_refused(end):
    camera = ColourCamera(CameraFile(COLOR_K, None, None), np.eye(4))
    with pytest.raises(InputError, match=r"^box: "):
        camera.depth_mask(np.ones((4, 6)), STANDARD_CAMERA, None, (0, 0, end, 1e3))


def test_extrinsics_are_read_from_files(tmp_path):
    T = rigid(T_COLOR_DEPTH)
    forms = {
        "a.txt": "\n".join(" ".join(map(str, row)) for row in T.tolist()),
        "b.json": json.dumps({"rotation": T[:3, :3].T.ravel().tolist(), "translation": T[:3, 3].tolist()}),
        "c.json": json.dumps({"rotation": T[:3, :3].tolist(), "translation": T[:3, 3].tolist()}),
        "d.json": json.dumps({"T_color_depth": T.tolist()}),
        "e.yaml": f"T_color_depth: {T.tolist()}\n",
    }
    for name, content in forms.items():
        (tmp_path / name).write_text(content)
        assert np.allclose(read_transform(tmp_path / name, "T_color_depth"), T), name
    for content in (
        "1 2 3",
        json.dumps({"T": T.tolist()}),
        json.dumps((2 * T).tolist()),
        "{",
        json.dumps(T.T.tolist()),
    ):
        (tmp_path / "bad.json").write_text(content)
        with pytest.raises(InputError, match=r"bad\.json"):
            read_transform(tmp_path / "bad.json", "T_color_depth")
    with pytest.raises(InputError, match=r"none\.txt"):
        read_transform(tmp_path / "none.txt", "T_color_depth")


# the world


def test_an_answer_in_the_world_frame():
    T = np.eye(4)
    T[:3] = [[0, 0, 1, 0.5], [-1, 0, 0, 0.2], [0, -1, 0, 1.1]]  # a level camera that looks along the world's x
    assert np.allclose(gravity_in_camera(T), [0, 1, 0])
    estimate = laptop_estimate()
    world = in_world(estimate, T)
    assert np.allclose(world["T_world_base"], T @ estimate.T_camera_base)
    pivot = estimate.joints[0].pivot
    assert pivot is not None
    assert np.allclose(world["joints"][0]["pivot"], [pivot[2] + 0.5, -pivot[0] + 0.2, -pivot[1] + 1.1])
    assert np.allclose(world["joints"][0]["axis"], T[:3, :3] @ estimate.joints[0].axis)
    assert np.shape(world["keypoints"]) == estimate.keypoints.shape
    assert json.dumps(world)


# what to check


def test_a_good_result_leaves_nothing_to_check():
    assert doubts(laptop_observation(), laptop_estimate()) == []


def test_a_wrong_depth_scale_is_named_with_its_cure():
    view = laptop_view()
    for factor, cure in ((10.0, "--depth-scale 0.0001"), (0.1, "--depth-scale 0.01")):
        mask = np.zeros(view.depth.shape, dtype=bool)
        mask[view.depth > 0] = True
        depth = np.where(mask, view.depth, 2.0)  # a wall behind it: the object was cut out
        seen = Observation.from_depth(depth * factor, K, mask)
        found = {check.name: check for check in doubts(seen, shared_estimator()(seen), 0.001)}
        assert cure in found["size"].cure, found["size"]
    points = laptop_observation().points * 0.001
    seen = Observation.from_points(points)
    found = {check.name: check for check in doubts(seen, laptop_estimate())}
    assert "1000" in found["size"].cure


def test_single_pixels_of_the_background_are_no_odd_size():
    view = laptop_observation()
    behind = np.where(np.arange(len(view.points)) % 200 == 0, 4.0, 1.0)  # of a mask's edge, the floor beside a table
    seen = replace(view, points=(view.points * behind[:, None]).astype(np.float32))
    assert np.ptp(seen.points, axis=0).max() > 4 * np.ptp(view.points, axis=0).max()
    assert list(size_doubts(seen, get_category("laptop"))) == []


def test_an_uncut_frame_is_named_with_its_cure():
    depth = np.full((480, 640), 4.0)
    depth[:240] = 2.0
    seen = Observation.from_depth(depth, K)
    found = {check.name: check for check in doubts(seen, laptop_estimate())}
    assert "--segment plane" in found["size"].cure
    assert "frame" in found


def test_few_points_a_bad_fit_and_an_unsure_network_are_named():
    estimate = laptop_estimate()
    few = Observation.from_points(laptop_observation().points[::200])
    assert [check.name for check in doubts(few, estimate)] == ["points"]
    bad = replace(estimate, residual=0.1, converged=False, keypoint_std=estimate.keypoint_std * 20)
    assert [check.name for check in doubts(laptop_observation(), bad)] == ["convergence", "residual", "network"]
    for check in doubts(laptop_observation(), bad):
        assert all(check.to_dict().values())


def test_a_doubtful_answer_has_something_to_look_at():
    estimate = laptop_estimate()
    assert [check.name for check in doubts(laptop_observation(), replace(estimate, probability=0.4))] == ["probability"]
    assert doubts(laptop_observation(), replace(estimate, probability=0.6)) == []


def test_an_object_on_its_side_is_named_where_nobody_told_of_gravity():
    estimator = shared_estimator("dishwasher")
    view = standard_view(generate(estimator.category, 1, "test"), estimator.category, (0, 1)).observation()
    upright = estimator(view)
    quarter = np.eye(4)
    quarter[:2, :2] = [[0, -1], [1, 0]]
    lying = replace(upright, placed=replace(upright.placed, T_camera_part=quarter @ upright.T_camera_part))
    for estimate, named in ((upright, []), (lying, ["gravity"])):
        found = gravity_doubts(view, estimate, Known(), estimator)
        assert [check.name for check in found] == named
    assert not gravity_doubts(laptop_observation(), laptop_estimate(), Known(), estimator)


def test_a_door_that_is_not_seen_is_named():
    """As where a hand or the border hides it: how far it is open is then a guess."""
    estimator, model = shared_estimator("dishwasher"), generate(get_category("dishwasher"), 1, "test")
    view = standard_view(model, estimator.category, (0, 1))
    seen, hidden = view.observation(), replace(view, mask=view.labels == 0).observation()
    for observation, named in ((seen, []), (hidden, ["part"])):
        estimate = estimator(observation)
        found = [check for check in doubts(observation, estimate) if check.name == "part"]
        assert [check.name for check in found] == named
        assert [text for text in estimate.warnings if text.startswith("part")] == [str(check) for check in found]
        assert not [check for check in doubts(observation, estimate.without_labels()) if check.name == "part"]
    assert "door" in found[0].what
    assert estimate.joints[0].state_std > 0.1


# which category


def test_the_category_is_found_and_ranked_before_others():
    names = ("scissors", "laptop", "drawer")
    ranking = rank(laptop_observation(), [shared_estimator(name) for name in names], always=names)
    ranked = ranking.candidates
    assert ranked[0].estimate.category.name == "laptop"
    assert {c.estimate.category.name for c in ranked} == set(names)
    assert [c.score for c in ranked] == sorted((c.score for c in ranked), reverse=True)
    assert np.isclose(sum(c.probability for c in ranked) + ranking.none, 1)
    assert not ranking.is_none
    assert suspected(ranked[0].estimate, ranking) == []
    (wrong,) = suspected(ranked[-1].estimate, ranking)
    assert "--category laptop" in wrong.cure


# a frame from end to end, and the page that describes it


PAGE = Path(__file__).parents[2] / "docs" / "own-camera.md"
LENS = Distortion("brown_conrady", BROWN)


def write_json(path: str, **content: object) -> None:
    Path(path).write_text(json.dumps(content))


@pytest.fixture
def frame(tmp_path, monkeypatch):
    """Files of a simulated RealSense frame: a laptop on a table, with camera noise, seen without and through a lens."""
    monkeypatch.chdir(tmp_path)
    scene, truth = on_a_table()
    noisy = add_noise(scene, LEVELS["on"], STANDARD_CAMERA, np.random.default_rng(0))
    save_png("depth.png", noisy)
    save_png("raw.png", seen_through(LENS, noisy))
    depth = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "ppx": 319.5, "ppy": 239.5}
    write_json("depth.json", **depth, model="Brown Conrady", coeffs=[0.0] * 5)
    write_json("raw.json", **depth, model="Brown Conrady", coeffs=list(LENS.coefficients))
    color = {"width": 1280, "height": 720, "fx": 920.0, "fy": 920.0, "ppx": 640.0, "ppy": 360.0}
    write_json("color.json", **color, model="Brown Conrady", coeffs=list(COLOR_LENS.coefficients))
    T = rigid(T_COLOR_DEPTH)
    write_json("depth-to-color.json", rotation=T[:3, :3].T.ravel().tolist(), translation=T[:3, 3].tolist())
    Image.fromarray(255 * color_mask(cloud_of(np.where(truth, scene, 0))).astype(np.uint8)).save("color-mask.png")
    Image.fromarray(255 * truth.astype(np.uint8)).save("mask.png")
    up = laptop_view().T_camera_base[:3, 1]
    across = np.cross(up, (0, 0, 1)) / np.linalg.norm(np.cross(up, (0, 0, 1)))
    np.savetxt("camera-pose.txt", rigid(np.c_[np.stack([across, np.cross(up, across), up]), (0.4, 0.0, 0.9)]))


RAW = ["--intrinsics", "raw.json", "--mask", "color-mask.png", "--color-intrinsics", "color.json"]
RAW += ["--color-extrinsics", "depth-to-color.json"]


@pytest.mark.slow
def test_a_raw_frame_with_a_colour_mask_is_as_good_as_an_ideal_one(frame, capsys):
    ideal = answer(capsys, "estimate", "depth.png", *LAPTOP, "--intrinsics", "depth.json", "--mask", "mask.png")
    raw = answer(capsys, "estimate", "raw.png", *LAPTOP, *RAW, "--world", "camera-pose.txt", "--gravity", "world")
    truth = laptop_view()
    for found in (ideal, raw):
        assert np.degrees(abs(found["joints"][0]["state"] - truth.states[0])) < 5
        T = np.array(found["T_camera_base"])
        assert np.linalg.norm(T[:3, 3] - truth.T_camera_base[:3, 3]) < 0.015
        assert np.arccos(np.clip(T[:3, 1] @ truth.T_camera_base[:3, 1], -1, 1)) < np.radians(4)
        assert found["checks"] == []
    assert np.degrees(abs(raw["joints"][0]["state"] - ideal["joints"][0]["state"])) < 3
    assert np.allclose(raw["joints"][0]["pivot"], ideal["joints"][0]["pivot"], atol=0.015)
    world = raw["world"]
    assert np.allclose(np.array(world["T_world_base"])[:3, 1], [0, 0, 1], atol=1e-6)  # upright, as told
    assert Path("omad-estimate/raw/estimate.html").is_file()


@pytest.mark.slow
def test_a_colour_camera_serves_frames_with_several_objects(frame, capsys):
    """Through a lens, with a box drawn in the colour image."""
    mask = np.asarray(Image.open("color-mask.png"))
    rows, columns = np.nonzero(mask)
    box = ",".join(map(str, (columns.min() - 5, rows.min() - 5, columns.max() + 5, rows.max() + 5)))
    Image.fromarray(np.stack([mask, mask // 2, 255 - mask], 2)).save("color.png")
    camera = [RAW[0], RAW[1], *RAW[4:], "--color", "color.png"]
    everywhere = answer(capsys, "detect", "raw.png", "--categories", "laptop", *camera)
    inside = answer(capsys, "detect", "raw.png", "--categories", "laptop", *camera, "--box", box)
    aside = answer(capsys, "detect", "raw.png", "--categories", "laptop", *camera, "--box", "0,0,200,100")
    alone = answer(capsys, "estimate", "raw.png", *LAPTOP, *camera, "--box", box)
    [found] = [one for one in inside["objects"] if one["category"] == "laptop"]
    assert found["box"] in [one["box"] for one in everywhere["objects"]]
    assert not any(one["category"] == "laptop" for one in aside["objects"])
    for joints in (found["estimate"]["joints"], alone["joints"]):
        assert np.degrees(abs(joints[0]["state"] - laptop_view().states[0])) < 5
    seen = np.asarray(Image.open("omad-detect/detect.png").convert("RGB")).reshape(-1, 3)
    assert np.count_nonzero((seen == (0, 0, 255)).all(1)) > 1000  # what it shows around the object
    assert "box" in refused(capsys, "detect", "raw.png", *camera, "--box", "1000,0,1001,1")


@pytest.mark.slow
def test_options_that_do_not_fit_are_refused(frame, capsys):
    depth = ["estimate", "depth.png", *LAPTOP, "--intrinsics", "depth.json"]
    for options, word in (
        (["--color-intrinsics", "color.json"], "--color-extrinsics"),
        (["--color-intrinsics", "color.json", "--color-extrinsics", "depth-to-color.json"], "--mask"),
        ([*RAW[2:4], "--color-intrinsics", "raw.json", *RAW[6:]], "1280x720"),
        (["--gravity", "world"], "--world"),
        (["--gravity", "0,0,0"], "--gravity 0,0,0"),
        (["--gravity", "down"], "--gravity down"),
        (["--world", "raw.json"], "T_world_camera"),
        (["--distortion", "oval:1"], "oval"),
    ):
        assert word in refused(capsys, *depth, *options)
    assert "640x480" in refused(capsys, "estimate", "depth.png", *LAPTOP, "--intrinsics", "color.json")
    auto = ["estimate", "depth.png", "--category", "auto", *K_OPTION]
    assert "auto" in refused(capsys, *auto, "--together", "depth-to-color.json")
    assert "elsewhere" in refused(capsys, *auto, "--weights", "elsewhere")


@pytest.mark.slow
def test_the_pages_commands_run(frame, capsys):
    lines = "".join(blocks(PAGE, "")).splitlines()
    assert len(lines) >= 6
    for line in lines:
        assert run(shlex.split(line)[1:]) == 0, line


@pytest.mark.slow
def test_the_pages_python_runs(frame, capsys):
    names: dict = {}
    for code in blocks(PAGE, "python"):
        exec(code, names)
    assert np.degrees(abs(names["estimate"].joint_states[0] - laptop_view().states[0])) < 5
    assert len(capsys.readouterr().out.splitlines()) >= 1


def test_the_page_knows_every_check():
    told = PAGE.read_text()
    names = "size depth points frame gravity convergence residual network part hand category probability"
    for name in names.split():
        assert f"`{name}`" in told
