"""Patches that hang in the air, against SciPy's components; a true part stays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from omad.geometry.camera import STANDARD_CAMERA
from omad.sensing.cutting.patches import APART, JUMP, SMALL, hanging
from omad.sensing.observation import Observation


def hanging_by_scipy(points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """The same in the plainest way, but for the thinning."""
    pairs = KDTree(pixels).query_pairs(1.5, output_type="ndarray")
    z = points[pairs, 2]
    pairs = pairs[np.abs(z[:, 0] - z[:, 1]) < JUMP * z.min(1)]
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    labels = connected_components(links, directed=False)[1]
    share = np.bincount(labels)[labels] / len(points)
    rest = points[share >= SMALL]
    reach = APART * np.linalg.norm(np.ptp(rest, axis=0))
    far = KDTree(rest).query(points)[0] > reach
    alone = np.array([far[labels == label].all() for label in range(labels.max() + 1)])
    return (share < SMALL) & alone[labels]


@pytest.mark.parametrize("seed", range(6))
def test_patches_are_those_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = np.zeros((60, 80), np.float32)
    depth[10:50, 10:60] = 1.0
    for _ in range(8):
        row, column = rng.integers(0, 55), rng.integers(0, 75)
        depth[row : row + rng.integers(1, 7), column : column + rng.integers(1, 7)] = rng.uniform(0.6, 1.4)
    rows, columns = np.nonzero(depth)
    pixels = np.stack([columns, rows], 1)
    points = np.column_stack([(pixels - (40, 30)) / 100 * depth[rows, columns, None], depth[rows, columns]])
    assert np.array_equal(hanging(points, pixels, depth.shape), hanging_by_scipy(points, pixels))


def test_a_patch_goes_and_a_part_stays_where_asked() -> None:
    depth = np.zeros((480, 640), np.float32)
    depth[150:300, 200:400] = 0.8
    depth[200:215, 300:320] = 0.5  # a patch
    depth[300:330, 200:260] = 0.84  # a part, a step behind
    seen = Observation.from_depth(depth, STANDARD_CAMERA, drop_flying=True)
    assert seen.mask is not None
    assert not seen.mask[200:215, 300:320].any()
    assert seen.mask[302:328, 202:258].all()
    assert np.array_equal(Observation.from_depth(depth, STANDARD_CAMERA).mask, depth > 0)
