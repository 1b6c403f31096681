"""Depth cameras err as real ones were measured to, and smooth fields have the statistics they state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from omad.data.rendering.sensor_noise import ACTIVE_STEREO, SENSORS, SPECKLE, TIME_OF_FLIGHT, Sensor, sense
from omad.data.rendering.smooth_fields import blobs, smooth_field

SHAPE = (480, 640)
PATCH = slice(160, 320), slice(240, 400)
SEEDS = 20
SILENT = Sensor(0.0, 1.0, 1.0, waves=0.5, length=10.0, grain=0.7)


def sensed(sensor: Sensor, depth: np.ndarray, seed: int = 0) -> np.ndarray:
    return sense(depth, sensor, np.ones_like(depth), np.random.default_rng(seed)).depth


def step() -> np.ndarray:
    """A disc 1 m away before a wall at 1.5 m."""
    v, u = np.indices(SHAPE)
    return np.where((u - 320) ** 2 + (v - 240) ** 2 < 150**2, 1.0, 1.5).astype(np.float32)


def residual(depth: np.ndarray) -> tuple[float, float]:
    """What a least-squares plane leaves of a patch of 160 x 160 pixels: variance, and covariance at 8 pixels, as the
    real frames were measured."""
    patch = depth[PATCH].astype(np.float64)
    v, u = np.indices(patch.shape)
    seen = patch > 0
    columns = np.stack([u[seen], v[seen], np.ones(seen.sum())], 1)
    left = np.full(patch.shape, np.nan)
    left[seen] = patch[seen] - columns @ np.linalg.lstsq(columns, patch[seen], rcond=None)[0]
    products = [left[:, 8:] * left[:, :-8], left[8:] * left[:-8]]
    return float(np.nanmean(left**2)), float(np.mean([np.nanmean(each) for each in products]))


@pytest.mark.parametrize(
    ("name", "distance", "millimetres", "correlation"),
    [
        ("active_stereo", 0.63, (2.9, 2.9), (0.79, 0.79)),
        ("coded_light", 0.64, (8.5, 8.5), (0.75, 0.90)),
        ("coded_light", 0.80, (9.6, 9.6), (0.75, 0.90)),
        ("speckle", 1.2, (3.6, 3.6), (0.19, 0.19)),
    ],
)
def test_errors_are_those_measured_on_real_frames(name, distance, millimetres, correlation) -> None:
    wall = np.full(SHAPE, distance, dtype=np.float32)
    measured = np.array([residual(sensed(SENSORS[name], wall, seed)) for seed in range(SEEDS)]).mean(0)
    sigma, rho = 1000 * np.sqrt(measured[0]), measured[1] / measured[0]
    assert millimetres[0] * 0.88 < sigma < millimetres[1] * 1.12
    assert correlation[0] - 0.04 < rho < correlation[1] + 0.04


@pytest.mark.parametrize("length", [0.7, 2.5, 6.0, 15.0])
def test_smooth_fields_are_correlated_as_stated(length: float) -> None:
    fields = np.stack([smooth_field((120, 160), length, np.random.default_rng(seed)) for seed in range(200)])
    fields = fields.astype(np.float64)
    assert fields.dtype == np.float64
    assert fields.mean() == pytest.approx(0, abs=0.03)
    assert (fields**2).mean() == pytest.approx(1, abs=0.05)
    assert (fields[:, 0, 0] ** 2).mean() == pytest.approx(1, abs=0.35)  # the corner as the middle
    for apart in (round(length) or 1, round(2 * length)):
        stated = np.exp(-(apart**2) / (4 * length**2))
        assert (fields[:, :, apart:] * fields[:, :, :-apart]).mean() == pytest.approx(stated, abs=0.05)
        assert (fields[:, apart:] * fields[:, :-apart]).mean() == pytest.approx(stated, abs=0.05)


def test_blobs_cover_their_share_of_what_is_asked() -> None:
    inside = step() < 1.2
    found = blobs(inside, 0.1, 5.0, np.random.default_rng(0))
    assert (found & inside).sum() / inside.sum() == pytest.approx(0.1, abs=0.002)
    assert (found[:, 1:] & found[:, :-1]).sum() / found.sum() > 0.8  # not single pixels
    assert not blobs(inside, 0.0, 5.0, np.random.default_rng(0)).any()


def test_same_generator_same_noise_and_nothing_stays_nothing() -> None:
    depth = step()
    depth[:100] = 0.0
    first, second, other = (sensed(ACTIVE_STEREO, depth, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)
    assert first.dtype == np.float32
    assert not first[:90].any()
    assert np.array_equal(sensed(SILENT, depth), depth)


def test_triangulation_errs_with_the_square_of_the_distance() -> None:
    smooth = replace(ACTIVE_STEREO, holes=0.0)
    near, far = (sensed(smooth, np.full(SHAPE, d, np.float32)).std() for d in (0.5, 1.0))
    assert far / near == pytest.approx(4, rel=0.05)


def test_steps_are_equal_in_disparity_and_as_wide_as_stated() -> None:
    ramp = np.broadcast_to(np.linspace(0.9, 1.1, SHAPE[1], dtype=np.float32), SHAPE)
    seen = np.unique(sensed(replace(SILENT, step=SPECKLE.step), np.ascontiguousarray(ramp)).astype(np.float64))
    assert np.diff(1 / seen) == pytest.approx(-SPECKLE.step, rel=1e-3)


def test_outlines_wander_and_labels_can_follow() -> None:
    depth = step()
    found = sense(depth, replace(SILENT, ragged=1.5), np.ones_like(depth), np.random.default_rng(0))
    assert np.array_equal(found.depth, depth.ravel()[found.source])
    v, u = np.indices(SHAPE)
    changed = found.depth != depth
    assert np.abs(np.hypot(u - 320, v - 240) - 150)[changed].max() < 9
    assert changed.sum() > 500


def test_only_edges_fly_and_they_lie_between() -> None:
    depth = step()
    found = sensed(replace(SILENT, flying=TIME_OF_FLIGHT.flying), depth)
    changed = found != depth
    assert (found[changed] > 1.0).all()
    assert (found[changed] < 1.5).all()
    v, u = np.indices(SHAPE)
    rim = np.abs(np.hypot(u - 320, v - 240) - 150) < 0.5
    assert changed[rim].mean() == pytest.approx(TIME_OF_FLIGHT.flying, abs=0.08)
    assert not changed[~(np.abs(np.hypot(u - 320, v - 240) - 150) < 3)].any()


def test_grazing_surfaces_are_lost() -> None:
    wall = np.ones(SHAPE, dtype=np.float32)
    for angle, kept in ((74, True), (76, False)):
        cosine = np.full(SHAPE, np.cos(np.radians(angle)), np.float32)
        sensor = replace(SILENT, grazing=float(np.radians(75)))
        assert (sense(wall, sensor, cosine, np.random.default_rng(0)).depth > 0).all() == kept
