"""Points that the network is shown: one of each image cell, by chance, the same everywhere."""

import numpy as np
import pytest

from omad.model.network_input import sample_clouds
from omad.objects.category_file import get_category
from omad.sensing.observation import Observation
from omad.sensing.point_choice import CELLS_SEEN, choose_points


def cloud_of_cells(per_cell: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A cloud (N, 3), and the cell (N,) each point lies in: ``per_cell`` (H, W) points in the cells of the first
    rows and columns, and one in the last of each, so that the grid is where it should be."""
    rng = np.random.default_rng(seed)
    cell = rng.permutation(np.repeat(np.arange(per_cell.size), per_cell.ravel()))
    place = np.stack([cell % per_cell.shape[1], cell // per_cell.shape[1]], 1) + rng.uniform(0.05, 0.95, (len(cell), 2))
    place = np.concatenate([place, [[0, 0], [CELLS_SEEN, CELLS_SEEN]]])
    depth = rng.uniform(0.5, 2.0, (len(place), 1))
    points = np.concatenate([place / 100 * depth, depth], 1).astype(np.float32)
    return points, np.concatenate([cell, [0, per_cell.size]])


def test_a_choice_shows_every_cell_once_before_any_twice() -> None:
    points, cell = cloud_of_cells(np.random.default_rng(1).integers(1, 9, (30, 30)))
    for choice in choose_points(points, 901, 3, 0):
        assert np.array_equal(np.sort(cell[choice]), np.arange(901))
    for choice in choose_points(points, 512, 3, 0):
        assert len(np.unique(cell[choice])) == 512
    [choice] = choose_points(points, 2000, 1, 0)
    assert np.array_equal(choice[901:1802], choice[:901])


def test_cells_and_the_points_of_a_cell_are_equally_likely() -> None:
    """Whatever the cells hold: chi-squared over its degrees of freedom is 1, and its deviation sqrt(2 / them)."""
    sizes = np.arange(1, 101).reshape(10, 10)
    points, cell = cloud_of_cells(sizes)
    samples, count = 20_000, 25
    drawn = np.bincount(choose_points(points, count, samples, 7).ravel(), minlength=len(points))
    by_cell = np.bincount(cell, drawn)
    expected = samples * count / 101
    # without replacement within a choice, the counts vary less than independent ones
    ratio = ((by_cell - expected) ** 2).sum() / expected / (1 - count / 101) / 100
    assert abs(ratio - 1) < 4 * np.sqrt(2 / 100)
    within = (by_cell / np.bincount(cell))[cell]
    ratio = ((drawn - within) ** 2 / within).sum() / (len(points) - 101)
    assert abs(ratio - 1) < 4 * np.sqrt(2 / (len(points) - 101))


def test_choices_of_one_cloud_differ_and_those_of_one_seed_do_not() -> None:
    points, _ = cloud_of_cells(np.full((20, 20), 30))
    first, second = choose_points(points, 256, 2, 3)
    assert len(np.intersect1d(first, second)) < 32
    assert not np.array_equal(first, choose_points(points, 256, 1, 4)[0])
    assert np.array_equal(choose_points(points, 256, 5, 3)[:2], [first, second])
    assert np.array_equal(choose_points(points.astype(np.float64), 256, 1, 3)[0], first)


def test_the_random_stream_is_the_published_one() -> None:
    """Of one cell, point number floor(n u), where u are the numbers of SplitMix64 in [0, 1)."""
    n, mask, state, expected = 1000, 2**64 - 1, 5, []
    for _ in range(20):
        for _cell in range(2):  # one number for the cell, one for the point
            state = (state + 0x9E3779B97F4A7C15) & mask
            mixed = ((state ^ state >> 30) * 0xBF58476D1CE4E5B9) & mask
            mixed = ((mixed ^ mixed >> 27) * 0x94D049BB133111EB) & mask
        expected.append(((mixed ^ mixed >> 31) >> 32) * n >> 32)
    assert choose_points(np.ones((n, 3)), 1, 20, 5).ravel().tolist() == expected


@pytest.mark.parametrize("points", [np.ones((3, 3)), np.eye(3), np.full((4, 3), 1e-30), -np.ones((2, 3))])
def test_small_and_degenerate_clouds_repeat(points: np.ndarray) -> None:
    chosen = choose_points(points, 64, 2, 0)
    assert chosen.shape == (2, 64)
    assert chosen.min() >= 0
    assert chosen.max() < len(points)


def test_a_batch_gives_what_single_calls_give() -> None:
    category = get_category("laptop")
    views = [Observation(cloud_of_cells(np.full((20, 20), 4), seed)[0]) for seed in range(3)]
    clouds, chosen = sample_clouds(views, 128, 4, 0, category, "cpu")
    assert clouds.shape == (3, 4, 128, 3)
    for view, cloud, index in zip(views, clouds, chosen, strict=True):
        [alone], [same] = sample_clouds([view], 128, 4, 0, category, "cpu")
        assert np.array_equal(alone, cloud)
        assert np.array_equal(same, index)
        assert np.allclose(cloud.reshape(-1, 3) * category.metres_per_unit, view.points[index])
