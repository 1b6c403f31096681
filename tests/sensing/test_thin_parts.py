"""Masks that are too narrow get back what is thin, and nothing else."""

import numpy as np
import pytest
from scipy import ndimage

from helpers.categories import CATEGORIES
from omad.data.procedural import generate
from omad.data.rendering.sensor_noise import SENSORS, sense
from omad.data.rendering.spoils.masks import grown
from omad.data.rendering.standard_views import standard_view
from omad.sensing import thin_parts
from omad.sensing.observation import Observation
from omad.sensing.thin_parts import BEHIND, HOLE, STEP, WIDTH, with_thin_parts


def scene() -> np.ndarray:
    """A block with a bar of five pixels that sticks out of it, before a wall."""
    depth = np.full((80, 120), 1.5, np.float32)
    depth[20:60, 10:50] = 1.0
    depth[38:43, 50:110] = 1.0
    return depth


def plain_thin_parts(mask: np.ndarray, depth: np.ndarray, hole: int) -> np.ndarray:
    """The definition, pixel by pixel, without ways over what is thin by holes alone."""

    def edge(row: int, column: int, down: int, right: int) -> int:
        rows, columns = row + down * np.arange(200), column + right * np.arange(200)
        inside = (rows >= 0) & (rows < depth.shape[0]) & (columns >= 0) & (columns < depth.shape[1])
        line = depth[rows[inside], columns[inside]]
        measured = np.flatnonzero(line)
        farthest = np.maximum.accumulate(line[measured])
        for i, at in enumerate(measured):
            beyond = measured[i + 1] if i + 1 < len(measured) else len(line)
            behind = beyond < len(line) and line[beyond] > farthest[i] * (1 + BEHIND)
            if behind or beyond - at - 1 > hole:
                return at + 1 if at < WIDTH else 10 * WIDTH
        return 10 * WIDTH

    thin = np.zeros_like(mask)
    for row, column in zip(*np.nonzero(depth), strict=True):
        for down, right in ((0, 1), (1, 0)):
            thin[row, column] |= edge(row, column, down, right) + edge(row, column, -down, -right) <= WIDTH
    found = mask.copy()
    while True:
        before = found.copy()
        for row, column in zip(*np.nonzero(before & (depth > 0)), strict=True):
            around = slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2)
            alike = np.abs(depth[around] - depth[row, column]) < STEP * depth[row, column]
            found[around] |= alike & thin[around] & (depth[around] > 0)
        if np.array_equal(before, found):
            return found


def test_a_lost_bar_comes_back_and_the_rim_of_a_block_does_not():
    depth = scene()
    whole = depth == 1.0
    narrow = grown(whole, -3)
    again = with_thin_parts(narrow, depth)
    assert not narrow[:, 52:].any()
    assert again[38:43, 52:110].all()
    assert not (again & ~whole).any()
    rim = whole & ~narrow
    rim[:, 45:] = False
    assert not (again & rim).any()


def test_a_right_mask_stays_as_it_is_and_so_does_a_wide_one():
    depth = scene()
    for mask in (depth == 1.0, grown(depth == 1.0, 4), np.ones_like(depth, bool), np.zeros_like(depth, bool)):
        np.testing.assert_array_equal(with_thin_parts(mask, depth), mask)


def test_a_mask_does_not_run_along_the_rim_of_a_table_seen_aslant():
    depth = np.zeros((120, 100), np.float32)
    depth[:90] = 1.3 - 0.004 * np.arange(90)[:, None]  # nearest at its rim; beyond, nothing is measured
    mask = np.zeros_like(depth, bool)
    mask[60:84, 40:60] = True
    np.testing.assert_array_equal(with_thin_parts(mask, depth), mask)


@pytest.mark.parametrize("lost", ["5 %", "20 %", "rows", "columns", "blobs"])
def test_a_right_mask_does_not_grow_over_a_table_with_holes(lost):
    depth = np.broadcast_to(1.3 - 0.002 * np.arange(240)[:, None], (240, 320)).astype(np.float32)
    depth[60:180, 90:200] = 0.9  # a block before it, whose foot is on it
    depth[150:180, 90:200] = depth[150:180, :1]
    mask = np.zeros_like(depth, bool)
    mask[60:180, 90:200] = True
    chance = np.random.default_rng(0).random(depth.shape)
    holes = {
        "5 %": chance < 0.05,
        "20 %": chance < 0.2,
        "rows": np.arange(240)[:, None] % 14 == 0,
        "columns": np.arange(320)[None] % 5 == 0,
        "blobs": ndimage.binary_dilation(chance < 0.004, np.ones((5, 5))),
    }
    depth[np.broadcast_to(holes[lost], depth.shape)] = 0
    again = with_thin_parts(mask, depth)
    assert (again & ~mask).sum() < 0.02 * mask.sum()


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_right_mask_does_not_grow_into_a_wall_whose_depth_is_noise(sensor):
    wall = np.broadcast_to(np.linspace(4.5, 5.5, 320, dtype=np.float32), (240, 320))
    depth = wall.copy()
    depth[60:180, 20:140] = 4.3
    depth[60:180, 140:200] = np.linspace(4.3, wall[0, 200], 60)  # a side that goes back to the wall
    seen = sense(depth, SENSORS[sensor], np.ones_like(depth), np.random.default_rng(3))
    mask = (depth < wall - 1e-6).ravel()[seen.source] & (seen.depth > 0)
    again = with_thin_parts(mask, seen.depth)
    assert (again & ~mask).sum() < 0.01 * mask.sum()


def test_a_bar_with_holes_comes_back():
    depth = scene()
    whole = depth == 1.0
    depth[np.random.default_rng(1).random(depth.shape) < 0.1] = 0
    again = with_thin_parts(grown(whole, -3), depth)
    assert again[38:43, 52:110].sum() > 0.95 * (depth[38:43, 52:110] > 0).sum()
    assert not (again & ~whole).any()


def test_whose_mask_grew_much_is_told():
    depth = scene()
    depth[20:60, 36:50] = 1.5  # a smaller block, so that the bar is much of it
    depth[38:43, 36:110] = 1.0
    whole = depth == 1.0
    camera = (100.0, 100.0, 59.5, 39.5)
    [warning] = Observation.from_depth(depth, camera, grown(whole, -3)).warnings
    assert warning.startswith("the mask seems too narrow: thin parts")
    assert not Observation.from_depth(depth, camera, whole).warnings


def test_what_goes_on_too_far_is_something_else():
    depth = np.zeros((400, 400), np.float32)
    depth[::20] = depth[:, ::20] = 1.0  # a net
    mask = np.zeros_like(depth, bool)
    mask[190:215, 190:215] = depth[190:215, 190:215] > 0
    np.testing.assert_array_equal(with_thin_parts(mask, depth), mask)


def test_a_bar_at_another_depth_is_not_run_into():
    depth = scene()
    depth[38:43, 70:110] = 0.9
    again = with_thin_parts(grown(depth < 1.2, -3) & (np.arange(120) < 50), depth)
    assert again[38:43, 52:69].all()
    assert not again[:, 70:].any()


def random_scene(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    depth = 1.0 + 0.03 * ndimage.gaussian_filter(rng.normal(size=(50, 60)), 2)
    depth[ndimage.gaussian_filter(rng.normal(size=depth.shape), 2) > 0.05] = 0
    depth = depth.astype(np.float32)
    mask = np.zeros_like(depth, bool)
    mask[8:42, 10:50] = depth[8:42, 10:50] > 0
    return mask, depth


@pytest.mark.parametrize("seed", range(4))
def test_it_is_what_the_definition_says(seed, monkeypatch):
    monkeypatch.setattr(thin_parts, "HOLE", 0)
    mask, depth = random_scene(seed)
    expected = plain_thin_parts(mask, depth, 0)
    assert expected.sum() > mask.sum()
    np.testing.assert_array_equal(with_thin_parts(mask, depth), expected)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_thin_by_holes_alone_is_no_more_than_a_way(seed):
    mask, depth = random_scene(seed)
    least, most = (plain_thin_parts(mask, depth, hole) for hole in (HOLE, 0))
    found = with_thin_parts(mask, depth)
    assert not (least & ~found).any()
    assert not (found & ~most).any()


def test_spectacles_whose_mask_is_too_narrow_are_seen_nearly_whole():
    category = CATEGORIES["eyeglasses"]
    shares = []
    for seed in range(12):
        view = standard_view(generate(category, seed, "test"), category, (seed, 0))
        whole = view.depth > 0
        narrow = grown(whole, -3)
        if narrow.sum() < 100:
            continue
        seen = Observation.from_depth(view.depth, view.camera, narrow).mask
        assert not (seen & ~whole).any()
        assert not (narrow & ~seen).any()
        shares.append((narrow.sum() / whole.sum(), seen.sum() / whole.sum()))
    before, after = np.mean(shares, axis=0)
    assert before < 0.6
    assert after > 0.8
