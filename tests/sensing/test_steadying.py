"""Steadied depth, against the plainest mean over neighbours of one surface."""

from __future__ import annotations

import numpy as np

from omad.geometry.camera import STANDARD_CAMERA, Camera
from omad.geometry.lens import Distortion
from omad.sensing.observation import Observation
from omad.sensing.steadying import JUMP, REACH, steadied


def test_depth_is_the_mean_of_the_surface_around_it() -> None:
    rng = np.random.default_rng(0)
    depth = np.zeros((480, 640), np.float32)
    depth[100:140, 200:240] = 1 + rng.normal(0, 0.005, (40, 40))
    depth[100:140, 240:270] = 1.5 + rng.normal(0, 0.005, (40, 30))
    depth[0:6, 0:10] = 2.0
    depth[rng.random(depth.shape) < 0.1] = 0
    seen = Observation.from_depth(depth, STANDARD_CAMERA)
    steady = steadied(seen)
    assert seen.pixels is not None
    assert np.allclose(STANDARD_CAMERA.project(steady.points), seen.pixels, atol=1e-2)
    for point, (column, row) in zip(steady.points, seen.pixels, strict=True):
        around = depth[max(row - REACH, 0) : row + REACH + 1, max(column - REACH, 0) : column + REACH + 1]
        same = around[np.abs(around - depth[row, column]) < JUMP * depth[row, column]]
        assert np.isclose(point[2], same.mean(), rtol=1e-5)


def test_of_a_large_image_neighbours_are_those_that_are_looked_at() -> None:
    rng = np.random.default_rng(0)
    depth = (1 + rng.normal(0, 0.005, (1080, 1920))).astype(np.float32)
    seen = Observation.from_depth(depth, Camera(1920, 1080, 1400.0, 1400.0, 959.5, 539.5))
    assert seen.every == 2
    assert seen.pixels is not None
    kept = depth[::2, ::2]
    some = rng.choice(len(seen.pixels), 300, replace=False)
    for point, (column, row) in zip(steadied(seen).points[some], seen.pixels[some] // 2, strict=True):
        around = kept[max(row - REACH, 0) : row + REACH + 1, max(column - REACH, 0) : column + REACH + 1]
        assert np.isclose(point[2], around.mean(), rtol=1e-5)


def test_points_of_which_a_lens_leaves_two_at_one_pixel_stay_points() -> None:
    rng = np.random.default_rng(0)
    depth = rng.choice(np.float32([0, 0.8, 1, 1.25]), (120, 160))
    seen = Observation.from_depth(depth, (100, 100, 79.5, 59.5), distortion=Distortion("plumb_bob", (0.3, 0.1, 0, 0)))
    assert seen.pixels is not None
    assert len(np.unique(seen.pixels, axis=0)) < len(seen.pixels)
    steady = steadied(seen)
    assert np.isclose(steady.points[:, 2], seen.points[:, 2], rtol=1e-5).all()


def test_a_cloud_has_no_neighbours() -> None:
    cloud = Observation.from_points(np.random.default_rng(0).normal(size=(100, 3)) + (0, 0, 5))
    assert steadied(cloud) is cloud
