"""What stands out of a door, and where: counted on doors of which every point is known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omad.estimation.looks.relief import FLOOR, STRIPS, as_shut, relief

UNIT = 0.8
WIDTH, HEIGHT = 0.6, 1.2
MIDDLES = (STRIPS[:-1] + STRIPS[1:]) / 2
PART_OF_KEYPOINT = [0, 0, 0, 0, 1, 1, 1, 1]


def corners(z: float) -> np.ndarray:
    return np.array([[x, y, z] for x in (0, WIDTH) for y in (0, HEIGHT)])


def shares(points: np.ndarray, state: float = 0.0, seed: int = 0) -> np.ndarray:
    """(3, 10) of a door hinged at x = 0, open by ``state``, its body behind it, somewhere before the camera."""
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = Rotation.random(rng=seed).as_matrix(), [0.2, -0.1, 2.0]
    opened = np.eye(4)
    opened[:3, :3] = Rotation.from_rotvec([0, -state, 0]).as_matrix()
    parts = np.stack([placed, placed @ opened])

    def seen(some: np.ndarray, part: int) -> np.ndarray:
        return some @ parts[part, :3, :3].T + parts[part, :3, 3]

    keypoints = np.concatenate([seen(corners(-0.5), 0), seen(corners(0.0), 1)])
    axis, pivot = parts[0, :3, :3] @ [0, 1.0, 0], parts[0, :3, 3]
    found = relief(seen(points, 1), keypoints, PART_OF_KEYPOINT, parts, axis, pivot, UNIT)
    return (np.exp(found) - FLOOR).reshape(3, -1)


def door(handle: float, height: float, seed: int = 0) -> np.ndarray:
    """(3000, 3) of a face with 2 mm of noise, of which a tenth is a handle ``height`` over it around x = ``handle``."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(0, WIDTH, 3000), rng.uniform(0, HEIGHT, 3000), rng.normal(0, 0.002, 3000)])
    points[::10] = [handle, HEIGHT / 2, height] + rng.uniform(-0.5, 0.5, (300, 3)) * [0.02, 0.3, 0.002]
    return points


@pytest.mark.parametrize("state", [0.0, 1.2])
@pytest.mark.parametrize("place", [0.2, 0.6, 0.8])
def test_a_handle_is_found_where_it_is(place, state):
    out, flat, behind = shares(door(place * WIDTH, 0.03), state, seed=round(10 * place))
    strip = np.searchsorted(STRIPS, place) - 1
    assert out[strip] == pytest.approx(0.1, abs=0.02)
    assert np.delete(out, strip).max() < 0.01
    assert flat.sum() + out.sum() + behind.sum() == pytest.approx(1, abs=0.1)
    assert behind.max() < 0.01


def test_what_is_sunk_in_is_behind():
    out, _, behind = shares(door(0.6 * WIDTH, -0.05))
    assert behind[np.searchsorted(STRIPS, 0.6) - 1] == pytest.approx(0.1, abs=0.02)
    assert out.max() < 0.01


def test_an_answer_that_is_a_little_off_changes_little():
    tilted = door(0.8 * WIDTH, 0.03) @ Rotation.from_rotvec([0.02, 0.03, 0]).as_matrix().T + [0, 0, 0.02]
    np.testing.assert_allclose(shares(tilted), shares(door(0.8 * WIDTH, 0.03)), atol=0.02)


def test_a_mirror_image_says_the_same_of_its_own_hinge():
    """And read with the hinge on the other side, the handle is on the other side."""
    seen = door(0.8 * WIDTH, 0.03)
    other = seen * [-1, 1, 1] + [WIDTH, 0, 0]
    inside = np.abs(MIDDLES - 0.5) < 0.6
    np.testing.assert_allclose(shares(other)[:, inside], shares(seen)[:, inside][:, ::-1], atol=0.02)


def test_where_no_face_is_seen_nothing_is_said():
    np.testing.assert_allclose(shares(door(0.5, 0.03) + [0, 0, 2.0]), 0, atol=1e-12)


def test_what_stands_out_counts_only_on_a_door_that_is_shut():
    known, out = np.array([1.0, -2.0]), np.array([3.0, 4.0, 5.0])
    assert as_shut(known, 6.0, 0.0, out) == pytest.approx([0, 0, 1, -2, 3, 4, 5, 1, 0, 6])
    assert as_shut(known, 6.0, np.radians(60), out) == pytest.approx([1, -2, 0, 0, 0, 0, 0, 0, 6, 0], abs=1e-12)
    ajar = as_shut(known, 6.0, np.radians(7), out)
    assert ajar[:2] + ajar[2:4] == pytest.approx(known)
    assert 0.3 < ajar[7] < 0.9
