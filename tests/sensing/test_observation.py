"""Depth and clouds to observations: geometry, cropping from clutter, and every kind of bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from helpers.categories import CATEGORIES, EVERY
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import ON, add_noise
from omad.data.rendering.rasteriser import rasterise
from omad.data.rendering.standard_views import standard_view
from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.sensing.observation import Observation
from omad.sensing.steadying import steadied
from omad.sensing.thin_parts import with_thin_parts

CAMERA = Camera(64, 48, 60.0, 61.0, 31.5, 23.5)
K = CAMERA.K


def bump() -> np.ndarray:
    depth = np.zeros((48, 64), dtype=np.float32)
    depth[10:30, 20:50] = np.random.default_rng(0).uniform(1, 1.01, (20, 30))
    return depth


def refused(*words: str, **arguments: object) -> None:
    """from_depth refuses with one line that holds all the words."""
    with pytest.raises(InputError) as error:
        Observation.from_depth(**{"depth_m": bump(), "K": K, **arguments})  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)


# geometry


@pytest.mark.parametrize("form", [K, K @ np.eye(3, 4), (60.0, 61.0, 31.5, 23.5), CAMERA, torch.tensor(K)])
def test_points_project_back_onto_their_pixels(form: object) -> None:
    depth = bump()
    seen = Observation.from_depth(depth, form)
    assert seen.points.dtype == np.float32
    assert seen.points.shape == (600, 3)
    assert seen.camera == CAMERA
    assert seen.pixels is not None
    u, v = seen.pixels.T
    assert np.allclose(seen.points[:, 2], depth[v, u])
    assert np.allclose(seen.points @ K[0] / seen.points[:, 2], u, atol=1e-4)
    assert np.allclose(seen.points @ K[1] / seen.points[:, 2], v, atol=1e-4)
    assert seen.mask is not None
    assert np.array_equal(seen.mask, depth > 0)
    assert seen.warnings == ()


def test_every_kind_of_missing_measurement_is_left_out() -> None:
    depth = bump().astype(np.float64)
    depth[10, 20:25] = np.nan, np.inf, -np.inf, -1.0, 0.0
    seen = Observation.from_depth(depth, K)
    assert len(seen.points) == 595
    assert seen.depth is not None
    assert not seen.depth[10, 20:25].any()


def test_what_masked_arrays_hide_is_left_out() -> None:
    near = np.arange(400).reshape(20, 20) < 200
    hidden = np.ma.array(np.ones((20, 20), np.float32), mask=~near)
    for depth, mask in ((hidden, None), (np.ones((20, 20)), np.ma.array(np.ones((20, 20), np.uint8), mask=~near))):
        assert np.array_equal(Observation.from_depth(depth, K, mask).mask, near)
    cloud = np.ma.array(np.ones((400, 3)), mask=np.repeat(~near.reshape(400, 1), 3, 1))
    assert len(Observation.from_points(cloud).points) == 200


def test_mask_and_box_combine_and_boxes_are_half_open() -> None:
    box = Observation.from_depth(bump(), K, box=(20, 10, 30, 16))
    assert box.pixels is not None
    assert box.pixels.min(0).tolist() == [20, 10]
    assert box.pixels.max(0).tolist() == [29, 15]
    mask = np.zeros((48, 64), dtype=np.uint8)
    mask[:20] = 255
    assert len(Observation.from_depth(bump(), K, mask=mask).points) == 300
    assert len(Observation.from_depth(bump(), K, mask=mask, box=(-5, -5, 30, 100)).points) == 100


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, ">f4"])
@pytest.mark.parametrize("masked", [False, True])
def test_points_are_those_of_the_formula_to_the_last_bit(dtype: str, masked: bool) -> None:
    rng = np.random.default_rng(0)
    given = rng.uniform(0.5, 2, (48, 64))
    for value in (0, -0.0, np.nan, np.inf, -np.inf, -1):
        given[rng.random(given.shape) < 0.05] = value
    given = given.astype(dtype)
    mask = rng.random(given.shape) < 0.5 if masked else None
    before = given.copy()
    seen = Observation.from_depth(given, CAMERA, mask)
    expected = np.where(np.isfinite(given) & (given > 0), given, 0).astype(np.float32)
    mask = None if mask is None else with_thin_parts(mask, expected)
    v, u = np.nonzero(expected if mask is None else expected * mask)
    z = expected[v, u].astype(np.float64)
    points = np.stack([(u - 31.5) / 60.0 * z, (v - 23.5) / 61.0 * z, z], 1).astype(np.float32)
    assert seen.depth is not None
    assert seen.depth.dtype == np.float32
    assert np.array_equal(seen.depth, expected)
    assert np.array_equal(seen.points, points)
    assert np.array_equal(seen.pixels, np.stack([u, v], 1))
    assert np.array_equal(seen.mask, expected.astype(bool) if mask is None else (expected > 0) & mask)
    assert np.array_equal(given, before, equal_nan=True)
    given[:] = 1  # the caller's buffer is used again
    assert np.array_equal(seen.depth, expected)


# bad depth, bad intrinsics, bad crops


@pytest.mark.parametrize("written", [8.0, 65.535])
def test_numbers_far_beyond_a_masked_object_are_left_out(written: float) -> None:
    depth = np.where(np.arange(80) % 20, 0.8, written) * np.ones((60, 1))
    mask = np.zeros((60, 80), bool)
    mask[20:40, 20:60] = True
    seen = Observation.from_depth(depth, (60, 60, 39.5, 29.5), mask)
    assert np.allclose(seen.points[:, 2], 0.8)
    assert seen.warnings[0].startswith(f"5% of the mask's pixels are {written:.3g} m away")
    wall = Observation.from_depth(np.where(depth == written, 2.4, depth), (60, 60, 39.5, 29.5), mask)
    assert len(wall.points) == mask.sum()  # which may be the object's
    few = np.where(depth == written, 0.8, depth)
    few[30, 30] = written
    assert Observation.from_depth(few, (60, 60, 39.5, 29.5), mask).warnings == ()


def test_an_axis_of_one_channel_or_one_image_may_be_there() -> None:
    for depth in (bump()[..., None], torch.tensor(bump())[None]):
        np.testing.assert_array_equal(Observation.from_depth(depth, K).points, Observation.from_depth(bump(), K).points)


def test_depth_of_a_wrong_kind() -> None:
    refused("(H, W)", "(48, 64, 3)", depth_m=np.ones((48, 64, 3)))
    refused("dtype", depth_m=np.ones((48, 64), dtype=bool))
    refused("array", depth_m=[[1.0, 2.0], [3.0]])


def test_depth_without_measurements() -> None:
    refused("all are zero or NaN", depth_m=np.zeros((48, 64)))
    refused("all are zero or NaN", depth_m=np.full((48, 64), np.nan))
    few = np.zeros((48, 64))
    few[0, :49] = 1
    refused("49", "50", depth_m=few)


def test_depth_along_minus_z_is_named() -> None:
    with pytest.raises(InputError, match="z points forward"):
        Observation.from_depth(np.full((60, 80), -0.8), (60, 60, 39.5, 29.5))


def test_millimetres_are_named() -> None:
    millimetres = bump() * 1000
    refused("millimetres", "0.001", depth_m=millimetres)
    refused("millimetres", "0.001", depth_m=millimetres.astype(np.uint16))
    refused("integers", "0.001", depth_m=np.ones((48, 64), dtype=np.int32))
    refused("centimetres", "0.01", depth_m=np.full((48, 64), 150.0))
    with pytest.raises(InputError, match="millimetres"):
        Observation.from_points(np.random.default_rng(0).normal(700, 100, (100, 3)))


def test_intrinsics() -> None:
    refused("none given", K=None)
    refused("(2, 2)", K=np.eye(2))
    refused("positive", K=(0, 60, 32, 24))
    refused("row by row", K=np.transpose(K))
    refused("positive", K=Camera(64, 48, -60.0, 61.0, 31.5, 23.5))
    refused("64x48", "640x480", K=STANDARD_CAMERA)
    nine = Observation.from_depth(bump(), np.ravel(K).tolist())  # as ROS has them
    assert np.array_equal(nine.points, Observation.from_depth(bump(), K).points)
    warnings = Observation.from_depth(bump(), (600, 600, 320, 240)).warnings
    assert len(warnings) == 1
    assert "principal point" in warnings[0]


def test_crops() -> None:
    refused("mask", "(10, 10)", "(48, 64)", mask=np.ones((10, 10)))
    refused("mask", "empty", mask=np.zeros((48, 64)))
    corner = np.zeros((48, 64))
    corner[:5, :5] = 1
    refused("0 of 600", mask=corner)
    refused("outside", "64x48", box=(70, 0, 80, 20))
    refused("x1 < x2", box=(30, 0, 20, 20))
    refused("in whole pixels", "0.1,0.2,0.5,0.6", box=(0.1, 0.2, 0.5, 0.6))
    refused("in whole pixels", "0.1,0.1,0.9,0.9", box=(0.1, 0.1, 0.9, 0.9))
    refused("mask", "read the file", "read_mask", mask="mask.png")
    refused("x1, y1, x2, y2", box=(1, 2, 3))
    refused("x1, y1, x2, y2", box=(1, 2, 3, float("nan")))
    refused("'plane'", segment="magic")


# clouds


def test_cloud() -> None:
    points = np.random.default_rng(0).uniform(0.5, 1, (100, 3))
    points[3] = np.nan
    points[4] = 0
    seen = Observation.from_points(points)
    assert seen.points.shape == (98, 3)
    assert seen.depth is None
    assert seen.warnings == ()
    assert np.array_equal(Observation.from_points(points.reshape(10, 10, 3)).points, seen.points)
    with pytest.raises(InputError, match=r"\(100, 6\); leave out what is no x, y, z: points\[:, :3\]"):
        Observation.from_points(np.c_[points, points])
    points[5:20, 2] *= -1
    assert "camera frame" in Observation.from_points(points).warnings[0]
    with pytest.raises(InputError, match="behind the camera; turn z forward"):
        Observation.from_points(-points)
    for bad, word in ((points[:, :2], "(N, 3)"), (points[:40], "at least 50"), (np.full((99, 3), np.nan), "0 valid")):
        with pytest.raises(InputError) as error:
            Observation.from_points(bad)
        assert word in str(error.value)


def test_a_few_points_at_the_cameras_plane_are_left_out() -> None:
    points = np.random.default_rng(0).uniform(0.5, 1, (1000, 3))
    seen = Observation.from_points(np.vstack([points, [(0.3, 0.1, 0.001), (0.3, 0.1, 0.0), (0.1, 0.1, -1.0)]]))
    assert len(seen.points) == 1000
    assert "3 point(s)" in seen.warnings[0]


def test_of_a_large_image_every_second_row_and_column_count_alike() -> None:
    depth = np.full((1080, 1920), 1.0, dtype=np.float32)
    depth[400:450, 900:950] = 0.4  # a patch that hangs in the air
    depth[:, :20] = 0.0
    camera = Camera(1920, 1080, 1400.0, 1400.0, 959.5, 539.5)
    seen = Observation.from_depth(depth, camera)
    assert seen.every == 2
    clean = seen.without_strays()
    assert clean.points[:, 2].min() > 0.9
    assert np.array_equal(clean.mask, depth == 1.0)
    part = seen.part(seen.pixels[:, 0] < 600)
    assert np.array_equal(part.mask, (depth > 0) & (np.arange(1920) < 600))
    rows = seen.pixels[:, 1]
    noisy = replace(seen, points=seen.points * (1 + 0.01 * (-1.0) ** (rows // 2))[:, None].astype(np.float32))
    assert np.ptp(steadied(noisy).points[rows > 500, 2]) < 0.7 * np.ptp(noisy.points[rows > 500, 2])


def test_flying_points_are_dropped_on_request() -> None:
    depth = np.zeros((48, 64), dtype=np.float32)
    depth[5:40, 5:60] = 1 + 0.01 * np.random.default_rng(0).random((35, 55))
    depth[5:40:7, 2] = (1.3, 1.5, 1.7, 1.9, 2.1)
    assert len(Observation.from_depth(depth, K).points) == 35 * 55 + 5
    kept = Observation.from_depth(depth, K, drop_flying=True)
    assert 35 * 55 * 0.98 <= len(kept.points) <= 35 * 55
    assert kept.points[:, 2].max() < 1.02


# clutter


def clutter(name: str, index: int, wall: bool, noisy: bool) -> tuple[np.ndarray, np.ndarray]:
    """Depth of a scene, and which pixels are the object's: a floor, a box, a post and perhaps a wall around it."""
    category = EVERY[name]
    model = generate(category, index, "test")
    view = standard_view(model, category, (0, index))
    posed = model.posed_vertices(view.states)
    ground, size = np.concatenate(posed).min(0)[1], model.diagonal

    def block(extents: tuple[float, float, float], place: tuple[float, float, float]) -> trimesh.Trimesh:
        mesh = trimesh.creation.box(np.multiply(extents, size))
        mesh.apply_translation(np.multiply(place, size) + (0, ground + extents[1] * size / 2, 0))
        return mesh

    things = [trimesh.Trimesh(v, p.faces, process=False) for v, p in zip(posed, model.parts, strict=True)]
    floor = block((8, 0.01, 8), (0, -0.01, 0))
    things += [floor, block((0.3, 0.3, 0.3), (1.1, 0, -0.3)), block((0.1, 0.4, 0.1), (-1, 0, 0.1))]
    if wall:
        things.append(block((8, 4, 0.01), (0, 0, -2)))
    scene = trimesh.util.concatenate(things)
    labels = np.repeat(np.arange(len(things)), [len(t.faces) for t in things])
    vertices = trimesh.transform_points(scene.vertices, view.T_camera_base)
    seen = rasterise(vertices, scene.faces, labels, STANDARD_CAMERA)
    depth = add_noise(seen.depth, ON if noisy else None, STANDARD_CAMERA, np.random.default_rng(0), seen.cos_view)
    return depth, (seen.labels < len(posed)) & (depth > 0)


THIN = (0.9, 0.6)
"""Usual and least overlap of things that are millimetres thick: the floor, or noise, takes a temple along."""


@pytest.mark.slow
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("name", CATEGORIES)
def test_an_object_is_cut_out_of_clutter(name: str, noisy: bool) -> None:
    """Most scenes succeed by themselves, and those that do not are announced."""
    usual, least = THIN if name in ("eyeglasses", "scissors") else (0.95, 0.8)
    overlaps, doubtful = [], []
    for index in range(10):
        depth, truth = clutter(name, index, wall=index % 2 == 1, noisy=noisy)
        found = Observation.from_depth(depth, STANDARD_CAMERA, segment="plane")
        assert found.mask is not None
        overlaps.append((found.mask & truth).sum() / (found.mask | truth).sum())
        doubtful.append(bool(found.warnings))
    assert np.median(overlaps) > usual
    assert sum(overlap > least for overlap in overlaps) >= 8
    assert all(overlap > least for overlap, doubt in zip(overlaps, doubtful, strict=True) if not doubt)


@pytest.mark.slow
def test_a_box_around_the_object_settles_what_is_meant() -> None:
    for index, margin in ((0, 20), (1, 20), (2, 20), (3, 20), (0, 0), (1, 0), (2, 0), (3, 0)):
        depth, truth = clutter("laptop", index, wall=False, noisy=False)
        rows, columns = np.nonzero(truth)
        box = (columns.min() - margin, rows.min() - margin, columns.max() + margin + 1, rows.max() + margin + 1)
        found = Observation.from_depth(depth, STANDARD_CAMERA, box=box, segment="plane")
        assert found.mask is not None
        assert (found.mask & truth).sum() / (found.mask | truth).sum() > 0.85


@pytest.mark.slow
def test_segmentation_is_repeatable_and_works_on_bare_clouds() -> None:
    depth, _ = clutter("dishwasher", 0, wall=True, noisy=True)
    first, second = (Observation.from_depth(depth, STANDARD_CAMERA, segment="plane") for _ in range(2))
    assert np.array_equal(first.points, second.points)
    cloud = Observation.from_depth(depth, STANDARD_CAMERA).points
    again = Observation.from_points(cloud, segment="plane")
    assert abs(len(again.points) - len(first.points)) < 0.01 * len(first.points)


def test_without_a_plane_the_thing_itself_is_taken_with_a_warning() -> None:
    ball = trimesh.creation.icosphere(4).vertices * 0.2 + (0, 0, 1)
    seen = Observation.from_points(ball, segment="plane")
    assert len(seen.points) > 0.9 * len(ball)
    assert any("no table" in warning for warning in seen.warnings)


# what is taken and shown


@pytest.mark.parametrize("scale", [1, 255.0, 1 / 255, 257])
def test_colours_are_bytes_shares_or_of_sixteen_bits(scale: float) -> None:
    color = np.random.default_rng(0).integers(0, 256, (48, 64, 3))
    kinds = {1: np.uint8, 257: np.uint16}
    given = color * 1.0 if scale == 255.0 else (color * scale).astype(kinds.get(scale, np.float64))
    seen = Observation.from_depth(bump(), K, color=given)
    assert seen.color is not None
    assert seen.color.dtype == np.uint8
    assert np.abs(seen.color.astype(int) - color).max() <= 1


def test_a_camera_may_have_sizes_that_are_floats() -> None:
    seen = Observation.from_depth(bump(), replace(CAMERA, width=64.0, height=48.0))  # type: ignore[arg-type]
    assert seen.camera == CAMERA
    assert type(seen.camera.width) is int
    assert np.array_equal(seen.points, Observation.from_depth(bump(), CAMERA).points)


def test_what_is_no_number_is_refused_with_the_cure_of_its_kind() -> None:
    refused("color: dtype bool", "integers up to 255, or floats", color=np.ones((48, 64, 3), bool))
    refused("color: ", "expected shape (H, W, 3)", color=np.ones((48, 64, 1, 3), np.uint8))
    refused("intrinsics: ", "a 3x3 matrix or (fx, fy, cx, cy)", K={1, 2})
    refused("depth: dtype bool", "floats in metres", depth_m=bump() > 0)
    refused("depth: ", "read the file first", depth_m="depth.png")


def test_an_observation_of_nothing_says_so() -> None:
    assert repr(Observation(np.zeros((0, 3), np.float32))).startswith("<Observation: 0 points")


@pytest.mark.parametrize("dtype", [np.uint8, np.int8])
def test_depth_of_eight_bits_is_refused(dtype) -> None:
    with pytest.raises(InputError, match="holds too few depth steps"):
        Observation.from_depth(np.full((48, 64), 100, dtype), np.array([[60, 0, 31.5], [0, 60, 23.5], [0, 0, 1.0]]))


@pytest.mark.parametrize(
    ("numbers", "asked"),
    [
        ((32, 24, 60, 60), "fx, fy, cx, cy, in this order"),
        ((60, 60, 23.5, 31.5), "is the image transposed"),
        ((60, 60, 60, 23.5), "are the intrinsics those of this image"),
    ],
)
def test_what_is_wrong_with_a_principal_point_is_guessed(numbers, asked) -> None:
    fx, fy, cx, cy = numbers
    seen = Observation.from_depth(np.full((48, 64), 1.0), np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))
    assert asked in seen.warnings[0]
