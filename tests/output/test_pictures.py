"""Pictures show the object large, and its colours where there are any; estimates print as one line."""

import base64
import io
import json
import re
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from helpers.categories import EVERY
from helpers.command_line import laptop_view, save_png
from omad.applications.detection.detector import Detection
from omad.cli.main import run
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.geometry.camera import Camera
from omad.geometry.rigid import box, carry
from omad.objects.model import ObjectModel
from omad.output.frame_image import frame_image
from omad.output.page import page_text
from omad.output.picture import DIFFERENCES, MAX_SIDE, PART_COLOURS, axis_segments, figure, part_colours, save, show
from omad.sensing.camera_files import CameraFile
from omad.sensing.colour_mask import ColourCamera
from omad.sensing.observation import Observation

RED = (200, 10, 30)


@cache
def seen() -> tuple[Observation, Estimate]:
    view = laptop_view()
    observation = Observation.from_depth(view.depth, view.camera, color=np.full((480, 640, 3), RED, np.uint8))
    return observation, Estimator.from_pretrained("laptop")(observation)


def centres(model: ObjectModel) -> np.ndarray:
    return np.stack([part.vertices.mean(0) for part in model.parts])


def test_the_object_fills_its_panels():
    observation, estimate = seen()
    panels = figure(observation, estimate).axes
    low, high = observation.pixels.min(0), observation.pixels.max(0)
    for panel in panels[:2]:
        (left, right), (bottom, top) = panel.get_xlim(), panel.get_ylim()
        assert left < low[0]
        assert right > high[0]
        assert max((high[0] - low[0]) / (right - left), (high[1] - low[1]) / (bottom - top)) > 0.8


@pytest.mark.parametrize("parts", sorted({len(category.parts) for category in EVERY.values()} | {16}))
def test_every_part_has_its_own_colour_and_none_is_that_of_no_part(parts):
    colours = part_colours(np.arange(-1, parts))
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=-1)[~np.eye(parts + 1, dtype=bool)]
    assert apart.min() > 0.15
    assert colours[0].tolist() == PART_COLOURS[-1].tolist() == [0.6, 0.6, 0.6]
    assert part_colours(parts - 1).tolist() == colours[-1].tolist()
    first = [[0.35, 0.6, 0.95], [1.0, 0.6, 0.25], [0.45, 0.8, 0.4], [0.85, 0.4, 0.75]]  # as in older pictures
    assert colours[1:5].tolist() == first[:parts]


def test_axes_are_drawn_where_joints_are_now_and_slides_through_what_they_move():
    lamp, chest = (generate(EVERY[name], 3, "test") for name in ("desk_lamp", "drawer"))
    placed = lamp.placed(lamp.limits[:, 1])
    segments = axis_segments(EVERY["desk_lamp"], placed, centres(lamp)[list(EVERY["desk_lamp"].part_of_keypoint)])
    for parent, pivot, (start, end) in zip(lamp.tree.parents, lamp.pivots, segments, strict=True):
        on_axis = carry(placed.T_camera_part[parent], pivot)
        assert np.linalg.norm(np.cross(end - start, on_axis - start)) < 1e-9
    keypoints = centres(chest)[list(EVERY["drawer"].part_of_keypoint)]
    slides = axis_segments(EVERY["drawer"], chest.placed(np.zeros(3)), keypoints)
    np.testing.assert_allclose(slides.mean(1), centres(chest)[1:], atol=1e-9)
    flat = np.linspace([-1.0, 0.0, -1.0], [1.0, 0.0, 1.0], EVERY["scissors"].num_keypoints)
    [[start, end]] = axis_segments(EVERY["scissors"], generate(EVERY["scissors"], 3, "test").placed(np.zeros(1)), flat)
    assert np.linalg.norm(end - start) > 0.5


def test_a_point_right_before_the_lens_makes_no_boundless_picture():
    points = seen()[0].points
    near = Observation.from_points(points - [0, 0, points[:, 2].min() - 1e-5])
    panels = figure(near, Estimator.from_pretrained("laptop")(near)).axes
    sizes = [max(image.get_array().shape) for panel in panels for image in panel.images]
    assert max(sizes) <= 640 + MAX_SIDE
    observation, right = seen()
    to_lens = right.placed.T_camera_part.copy()
    to_lens[:, :3, 3] -= to_lens[0, :3, 3]
    panels = figure(observation, replace(right, placed=replace(right.placed, T_camera_part=to_lens))).axes
    assert max(max(image.get_array().shape) for panel in panels for image in panel.images) == 640 + MAX_SIDE


def test_a_large_image_is_drawn_as_a_small_one(monkeypatch):
    observation, right = seen()
    monkeypatch.setattr("omad.output.picture.MAX_SIDE", 320)
    panels = figure(observation, right).axes
    assert panels[0].images[0].get_array().shape == panels[1].images[0].get_array().shape[:2] == (240, 320)
    [explained] = re.findall(r"(\d+)% of the pixels explained", panels[3].get_title())
    assert int(explained) > 90


def test_notebooks_display_what_show_returns_and_it_is_written_as_named(tmp_path):
    shown = show(*seen(), path=tmp_path / "picture")
    assert Image.open(io.BytesIO(shown._repr_png_())).size[0] > 800
    assert Image.open(tmp_path / "picture").format == "PNG"
    assert [file.name for file in tmp_path.iterdir()] == ["picture"]


def test_a_name_in_any_script_is_drawn_without_a_warning(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        save(figure(*seen(), title="深.png"), tmp_path / "estimate.png")


def test_colours_lie_under_what_is_drawn():
    observation, estimate = seen()
    [image] = figure(observation, estimate).axes[1].images
    assert tuple(image.get_array()[0, 0]) == RED
    found = re.findall(
        r'<script id="data" type="application/json">(.*?)</script>', page_text(observation, estimate), re.S
    )
    picture = json.loads(found[0])["picture"]
    assert picture["colours"] is True
    stored = Image.open(io.BytesIO(base64.b64decode(picture["source"].partition(",")[2])))
    assert np.abs(np.asarray(stored).reshape(-1, 3).mean(0) - RED).max() < 5
    depth = frame_image(Observation.from_depth(laptop_view().depth, laptop_view().camera))
    assert tuple(depth[0, 0]) == (255, 255, 255)  # not measured


def test_colours_of_a_camera_beside_are_looked_up():
    """Two cameras 5 cm apart before a wall 1 m away: what one sees is shifted by 30 of 600 pixels."""
    shifted = np.eye(4)
    shifted[0, 3] = 0.05
    camera = Camera(64, 48, 600, 600, 31.5, 23.5)
    color = np.broadcast_to(np.arange(128, dtype=np.uint8)[None, :, None], (48, 128, 3))
    beside = ColourCamera(CameraFile(camera.K), shifted)
    depth = np.ones((48, 64), np.float32)
    depth[0, 0] = 0
    found = beside.seen_from_depth(depth, camera, color)
    assert np.array_equal(found[5, :, 0], np.arange(64) + 30)
    assert not found[0, 0].any()


def test_colours_of_another_size_are_refused():
    view = laptop_view()
    with pytest.raises(InputError, match="aligned"):
        Observation.from_depth(view.depth, view.camera, color=np.zeros((240, 320, 3), np.uint8))


def test_estimates_print_as_one_line_that_tells_the_joints():
    observation, estimate = seen()
    joint = estimate.joints[0]
    assert re.fullmatch(
        r"<Estimate of a laptop: hinge -?\d+\.\d° ± \d+\.\d°; base at .* m; right .* \d+%>", repr(estimate)
    )
    assert repr(joint) == f"<{joint} (revolute, -80.0° to 85.0°)>"
    assert "-0" not in joint.shown(-1e-9)
    thing = Detection(observation, {"laptop": 0.9, None: 0.1}, estimate, {})
    assert repr(thing) == f"<Detection: laptop 90%: {joint}>"
    for value in (observation, estimate.initial, estimate.parts[0], estimate.parts, estimate.object_model().parts):
        assert len(repr(value)) < 200
    with pytest.raises(InputError, match=r"give omad.show\(observation, estimate\)"):
        show(estimate, observation)
    with pytest.raises(InputError, match=r"estimate\.xyz: .*\.png"):
        show(observation, estimate, "estimate.xyz")


def test_masks_may_be_jpeg(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Image.fromarray(np.uint8(laptop_view().depth > 0) * 255).save("mask.jpg", quality=70)
    given = ["--category", "laptop", "--intrinsics", "600,600,319.5,239.5", "--mask", "mask.jpg"]
    assert run(["estimate", save_png("depth.png"), *given]) == 0
    assert run(["estimate", "depth.png", *given, "--mask-id", "3"]) == 2


def test_the_demo_names_its_pages(tmp_path, capsys):
    assert run(["demo", "--category", "laptop", "--objects", "1", "--output", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    for name in ("estimate.png", "estimate.html"):
        assert str(next(tmp_path.rglob(name))) in out


def places(image, shown: np.ndarray) -> np.ndarray:
    """(N, 2) where in its panel a picture's pixels ``shown`` (H, W) are; its first row is at the end of its extent."""
    left, right, last, first = image.get_extent()
    rows, columns = np.nonzero(shown)
    height, width = shown.shape
    return np.stack(
        [left + (columns + 0.5) / width * (right - left), first + (rows + 0.5) / height * (last - first)], 1
    )


def test_panels_of_the_limits_show_the_object_there():
    observation, estimate = seen()
    panels, model = figure(observation, estimate).axes, estimate.object_model()
    for panel, name, end in ((panels[4], "lower", 0), (panels[5], "upper", 1)):
        assert name in panel.get_title()
        [image] = panel.images
        states = np.array([joint.limits[end] for joint in estimate.joints])
        there = carry(estimate.T_camera_base, np.concatenate(model.posed_vertices(states)))
        drawn = places(image, (image.get_array() < 1).any(2))
        assert box(drawn) == pytest.approx(box(observation.camera.project(there)), abs=2)


def test_what_is_not_explained_is_tinted_where_it_was_seen():
    observation, estimate = seen()
    higher = estimate.placed.T_camera_part.copy()
    higher[:, 1, 3] -= 0.05  # of y down
    hulls = replace(estimate, surfaces=None, placed=replace(estimate.placed, T_camera_part=higher))
    image = figure(observation, hulls).axes[3].images[1]
    colour = np.abs(image.get_array()[..., :3] - to_rgb(DIFFERENCES["missing"][1])).max(2) < 1e-6
    column, row = np.rint(places(image, colour & (image.get_array()[..., 3] > 0))).astype(int).T
    assert len(row) > 100
    assert (observation.depth[row, column] > 0).mean() > 0.9
    assert row.mean() > observation.pixels[:, 1].mean() + 10  # the surface is too high


def test_from_the_side_the_cloud_lies_on_the_object():
    observation, estimate = seen()
    panel = figure(observation, estimate).axes[2]
    offsets = [np.asarray(each.get_offsets()) for each in panel.collections]
    drawn = np.concatenate([each for each in offsets if len(each) > 1])
    there = carry(np.linalg.inv(laptop_view().T_camera_base), observation.points)[:, [2, 1]]  # the truth
    assert box(drawn) == pytest.approx(box(there), abs=0.02)
    outlines = np.concatenate([path.vertices for each in panel.collections for path in each.get_paths()][1:])
    assert box(outlines) == pytest.approx(box(there), abs=0.05)


def test_true_axes_are_dotted_where_they_are():
    observation, estimate = seen()
    there = np.array([[0.05, 0.02, estimate.placed.pivots[0, 2]]])
    truth = replace(estimate.placed, axes=np.array([[0.6, 0.8, 0.0]]), pivots=there)
    [dotted] = [line for line in figure(observation, estimate, truth).axes[1].lines if line.get_linestyle() == ":"]
    (start, end), [middle] = np.transpose(dotted.get_data()), observation.camera.project(there)
    along = (end - start) / np.linalg.norm(end - start)
    assert np.abs(along) == pytest.approx([0.6, 0.8], abs=1e-6)
    assert abs(np.cross(along, middle - start)) < 0.1


def test_points_that_are_thinned_out_keep_their_colours(monkeypatch):
    monkeypatch.setattr("omad.output.picture.MAX_DRAWN", 500)
    observation, estimate = seen()
    cloud = figure(observation, estimate).axes[1].collections[0]
    pixels, colours = np.asarray(cloud.get_offsets()), cloud.get_facecolors()[:, :3]
    assert 100 < len(pixels) <= 500
    label = {tuple(pixel): of for pixel, of in zip(observation.pixels.tolist(), estimate.part_labels, strict=True)}
    own = part_colours(np.array([label[tuple(pixel)] for pixel in np.rint(pixels).astype(int).tolist()]))
    assert np.allclose(colours, own)
