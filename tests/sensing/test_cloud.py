"""What the loops over a whole image do, against NumPy in the plainest way."""

import numpy as np
import pytest

from omad.geometry.back_projection import back_projected, pixels_at
from omad.geometry.camera import Camera
from omad.geometry.lens import Distortion
from omad.sensing.cutting.cloud import BORDER, CELLS, COARSE, Cloud
from omad.sensing.cutting.footprints import DIRECTIONS, axes_of, within
from omad.sensing.cutting.planes import _votes

CAMERA = Camera(64, 48, 60.0, 61.0, 30.3, 24.1)


def image(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H, W) of a tilted plane with noise, and which of its pixels are used."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((CAMERA.height, CAMERA.width))
    depth = 1.2 - 0.006 * rows + 0.002 * columns + 0.003 * rng.normal(size=rows.shape)
    return depth.astype(np.float32), rng.random(rows.shape) < 0.8


def cloud(seed: int = 0) -> Cloud:
    return Cloud.of(back_projected(CAMERA, *image(seed))[1])


@pytest.mark.parametrize("lens", [None, Distortion("plumb_bob", (-0.1, 0.02))])
@pytest.mark.parametrize("order", ["C", "F"])
def test_points_are_those_of_the_camera(lens: Distortion | None, order: str) -> None:
    camera = Camera(64, 48, 60.0, 61.0, 30.3, 24.1, lens)
    depth, used = (np.asarray(values, order=order) for values in image(0))
    place, points = back_projected(camera, depth, used)
    rows, columns = np.nonzero(used)
    assert np.array_equal(place, rows * 64 + columns)
    assert np.array_equal(pixels_at(place, 64), np.stack([columns, rows], 1))
    expected = camera.backproject(np.stack([columns, rows], 1), depth[used])
    assert np.array_equal(points.astype(np.float32), expected.astype(np.float32))


def test_cells_and_scales_are_those_of_the_places() -> None:
    seen = cloud()
    x, y = place = seen.places(np.arange(len(seen.scale)))
    assert np.array_equal(seen.at_border, np.abs(place).max(0) > np.float32(1 - BORDER))
    cell_of = ((place.astype(np.float64) + 1) * (CELLS / 2)).astype(int)
    assert np.array_equal(seen.cell, cell_of[0] * (CELLS + 1) + cell_of[1])
    assert x.min() == y.min() == -1 == -x.max() == -y.max()
    distance = np.linalg.norm(seen.points, axis=0)
    assert seen.scale == pytest.approx(distance**2 / np.median(distance), rel=1e-6)


def test_heights_near_a_plane_are_means_of_their_cells() -> None:
    seen = cloud()
    plane = np.array([0.0, -0.29, -0.957, -1.13])
    height = (plane[:3] @ seen.points - plane[3]) / seen.scale
    near = np.abs(height) < COARSE
    assert 0.05 < near.mean() < 0.95
    total, count = (np.bincount(seen.cell[near], weights) for weights in (height[near], None))
    expected = height.copy()
    expected[near] = total[seen.cell[near]] / count[seen.cell[near]]
    assert seen.heights(plane)[0] == pytest.approx(expected, abs=1e-6)


def test_votes_are_counts() -> None:
    rng = np.random.default_rng(0)
    points, planes = rng.normal(size=(3, 300)).astype(np.float32), rng.normal(size=(20, 4)).astype(np.float32)
    taken, below = (10 * rng.random((2, 300))).astype(np.float32)
    height = planes[:, :3] @ points - planes[:, 3:]
    on, wide, close = (np.count_nonzero(np.abs(height) < share * taken, axis=1) for share in (0.01, 0.02, 0.002))
    expected = np.stack([2 * on - wide, close, np.count_nonzero(height < below, axis=1)])
    assert np.abs(_votes(points, taken, below, planes) - expected).max() <= 1  # rounding


def test_within_an_outline_is_short_of_it_in_all_directions() -> None:
    seen, rng = cloud(), np.random.default_rng(0)
    axes, outline = axes_of(np.array([0.0, -0.6, -0.8, -1.0])), rng.uniform(0.1, 0.9, 16).astype(np.float32)
    reach = DIRECTIONS @ axes @ seen.points
    expected = (reach <= outline[:, None]).all(0)
    assert 0.05 < expected.mean() < 0.95
    assert np.count_nonzero(within(outline, axes, seen.points) != expected) <= 1  # rounding
