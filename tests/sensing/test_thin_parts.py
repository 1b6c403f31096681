"""Masks that are too narrow get back what is thin, and nothing else."""

import numpy as np
import pytest
from scipy import ndimage

from helpers.categories import CATEGORIES
from omad.data.procedural import generate
from omad.data.rendering.sensor_noise import SENSORS, sense
from omad.data.rendering.spoils.masks import grown
from omad.data.rendering.standard_views import standard_view
from omad.sensing.observation import Observation
from omad.sensing.thin_parts import BEHIND, STEP, WIDTH, with_thin_parts


def scene() -> np.ndarray:
    """A block with a bar of five pixels that sticks out of it, before a wall."""
    depth = np.full((80, 120), 1.5, np.float32)
    depth[20:60, 10:50] = 1.0
    depth[38:43, 50:110] = 1.0
    return depth


def plain_thin_parts(mask: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """The definition, pixel by pixel."""

    def edge(row: int, column: int, down: int, right: int) -> int:
        farthest = depth[row, column]
        for steps in range(1, WIDTH + 1):
            r, c = row + steps * down, column + steps * right
            if not (0 <= r < depth.shape[0] and 0 <= c < depth.shape[1]):
                break
            if depth[r, c] == 0 or depth[r, c] > farthest * (1 + BEHIND):
                return steps
            farthest = max(farthest, depth[r, c])
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


@pytest.mark.parametrize("seed", range(4))
def test_it_is_what_the_definition_says(seed):
    rng = np.random.default_rng(seed)
    depth = 1.0 + 0.03 * ndimage.gaussian_filter(rng.normal(size=(50, 60)), 2)
    depth[ndimage.gaussian_filter(rng.normal(size=depth.shape), 2) > 0.05] = 0
    depth = depth.astype(np.float32)
    mask = np.zeros_like(depth, bool)
    mask[8:42, 10:50] = depth[8:42, 10:50] > 0
    expected = plain_thin_parts(mask, depth)
    assert expected.sum() > mask.sum()
    np.testing.assert_array_equal(with_thin_parts(mask, depth), expected)


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
