"""Labels of all points come from the nearest points that the network saw."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from omad.estimation.nearest import nearest
from omad.estimation.part_labels import LabelledPoints


def plate(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.column_stack([rng.uniform(-0.2, 0.2, (count, 2)), np.full(count, 0.7)])


FEW = {
    "cloud": lambda rng: rng.normal(size=(800, 3)),
    "one": lambda rng: rng.normal(size=(1, 3)),
    "plate": lambda rng: plate(rng, 300),
    "a point again and again": lambda rng: np.repeat(rng.normal(size=(1, 3)), 9, axis=0),
    "with one far away": lambda rng: np.concatenate([plate(rng, 300), [[40.0, -7.0, 90.0]]]),
}


@pytest.mark.parametrize("few", FEW.values(), ids=FEW.keys())
def test_nearest_is_that_of_a_tree_search(few):
    rng = np.random.default_rng(0)
    some = few(rng).astype(np.float32)
    spread = np.concatenate([rng.normal(size=(500, 3)), plate(rng, 500), some[rng.integers(len(some), size=200)]])
    points = spread.astype(np.float32)
    found = np.linalg.norm(some[nearest(points, some)].astype(np.float64) - points, axis=1)
    np.testing.assert_allclose(found, KDTree(some).query(points)[0], rtol=1e-12, atol=0)


def test_points_take_the_label_of_the_nearest_seen():
    points = np.column_stack([np.linspace(0, 1, 11), np.zeros(11), np.ones(11)]).astype(np.float32)
    logits = np.array([[0.1, 0.2, 3.0], [2.0, 1.0, 0.0], [0.0, 4.0, 1.0]])
    labelled = LabelledPoints(points, np.array([10, 0, 5]), logits, 3)
    assert labelled.labels.tolist() == [0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2]


def test_no_points_have_no_labels():
    assert LabelledPoints.none().labels.shape == (0,)
