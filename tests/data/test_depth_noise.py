"""Every statistic that the depth noise promises, one at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from omad.data.rendering.depth_noise import DOUBLE, HALF, LEVELS, ON, NoiseLevel, add_noise
from omad.geometry.camera import STANDARD_CAMERA as CAMERA

SILENT = NoiseLevel(shift=0, disparity=0, step=0, edge_drop=0, holes=0)
WALL = np.full((CAMERA.height, CAMERA.width), 1.0, dtype=np.float32)
FB = CAMERA.fx * ON.baseline


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def disc(radius: float = 150) -> np.ndarray:
    v, u = np.indices(WALL.shape)
    return np.where((u - 320) ** 2 + (v - 240) ** 2 < radius**2, 1.0, 0.0).astype(np.float32)


def tilted(angle: float) -> np.ndarray:
    """A plane turned by ``angle`` about the image's vertical axis, 1 m away in the middle."""
    u = np.arange(CAMERA.width)
    slope = (u - CAMERA.cx) / CAMERA.fx * np.tan(angle)
    row = np.where(1 - slope > 0.2, 1 / np.maximum(1 - slope, 0.2), 0)
    return np.broadcast_to(row, WALL.shape).astype(np.float32)


def test_off_and_empty_change_nothing() -> None:
    assert np.array_equal(add_noise(WALL, None, CAMERA, rng()), WALL)
    assert np.allclose(add_noise(WALL, SILENT, CAMERA, rng()), WALL, atol=1e-6)
    assert not add_noise(np.zeros_like(WALL), ON, CAMERA, rng()).any()


def test_same_generator_same_noise_and_the_input_is_untouched() -> None:
    depth = disc()
    first, second, other = (add_noise(depth, ON, CAMERA, rng(s)) for s in (1, 1, 2))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)
    assert np.array_equal(depth, disc())
    assert first.dtype == np.float32


def test_disparity_noise_is_a_third_of_its_sigma_after_smoothing_and_correlated() -> None:
    noisy = add_noise(WALL, replace(SILENT, disparity=0.08), CAMERA, rng())
    error = FB / noisy - FB / WALL
    assert error.std() == pytest.approx(0.08 / 3, rel=0.03)
    assert abs(error.mean()) < 1e-3
    along = (error[:, 1:] * error[:, :-1]).mean() / error.var()
    assert along == pytest.approx(2 / 3, abs=0.03)


def test_depth_error_grows_with_the_square_of_the_distance() -> None:
    level = replace(SILENT, disparity=0.08)
    near, far = (add_noise(d * WALL, level, CAMERA, rng()).std() for d in (1.0, 2.0))
    assert far / near == pytest.approx(4, rel=0.05)


def test_disparity_is_quantised() -> None:
    noisy = add_noise(tilted(0.5), replace(ON, edge_drop=0, holes=0), CAMERA, rng())
    steps = FB / noisy[noisy > 0].astype(np.float64) * 32
    assert np.abs(steps - np.rint(steps)).max() < 1e-3


def test_pixels_shift_by_the_stated_sigma() -> None:
    ramp = tilted(0.6)
    per_pixel = np.gradient(ramp, axis=1)
    moved = (add_noise(ramp, replace(SILENT, shift=2.0), CAMERA, rng()) - ramp)[:, 50:-50] / per_pixel[:, 50:-50]
    assert moved.std() == pytest.approx(2.0, rel=0.05)


def test_half_of_the_edge_pixels_are_lost_and_no_others() -> None:
    depth = disc()
    depth[220:260, 300:340] = 0.8  # in front of the disc
    noisy = add_noise(depth, replace(SILENT, edge_drop=0.5), CAMERA, rng())
    v, u = np.indices(depth.shape)
    from_rim = np.abs(np.hypot(u - 320, v - 240) - 150)
    lost = (depth > 0) & (noisy == 0)
    inner = (u > 290) & (u < 350) & (v > 210) & (v < 270)
    assert not lost[~inner & (from_rim > 3)].any()
    rim = (depth > 0) & (from_rim < 0.9)
    assert lost[rim].mean() == pytest.approx(0.5, abs=0.06)
    assert 100 < lost[inner].sum() < 200  # half of the 2 x 160 pixels on both sides of the outline
    assert not lost[224:256, 304:336].any()


@pytest.mark.parametrize("given", [True, False])
def test_grazing_surfaces_are_lost(given: bool) -> None:
    level = replace(SILENT)
    for angle, kept in ((75.0, True), (84.0, False)):
        depth = tilted(np.radians(angle))
        column = CAMERA.width // 2  # here the angle to the ray is the plane's tilt
        cosine = np.full(depth.shape, np.cos(np.radians(angle))) if given else None
        noisy = add_noise(depth, level, CAMERA, rng(), cosine)
        assert (noisy[:, column] > 0).all() == kept
        assert (noisy[:, column] > 0).any() == kept


def test_edges_do_not_pass_for_grazing_surfaces() -> None:
    depth = disc()
    assert np.array_equal(add_noise(depth, SILENT, CAMERA, rng()) > 0, depth > 0)


@pytest.mark.slow
def test_holes_cover_their_share_in_blobs() -> None:
    noisy = add_noise(WALL, replace(SILENT, holes=0.005), CAMERA, rng())
    hole = noisy == 0
    assert hole.mean() == pytest.approx(0.005, abs=0.0005)
    beside = hole[:, 1:] & hole[:, :-1]
    assert beside.sum() / hole.sum() > 0.7  # blobs, not single pixels
    places = [add_noise(disc(), replace(SILENT, holes=0.005), CAMERA, rng(s)) == 0 for s in range(40)]
    share = np.mean([(p & (disc() > 0)).sum() / (disc() > 0).sum() for p in places])
    assert share == pytest.approx(0.005, abs=0.001)


def test_levels_are_ordered() -> None:
    errors, kept = [], []
    for level in (HALF, ON, DOUBLE):
        noisy = add_noise(tilted(0.5), level, CAMERA, rng())
        errors.append(np.abs(noisy - tilted(0.5))[noisy > 0].mean())
        kept.append((noisy > 0).mean())
    assert errors[0] < errors[1] < errors[2]
    assert kept[0] > kept[1] > kept[2]
    assert list(LEVELS) == ["off", "half", "on", "double"]
    assert DOUBLE.edge_drop == 1.0
    assert DOUBLE.baseline == HALF.baseline == 0.05
