"""What errors of views of one object have in common, against errors that were drawn so."""

import numpy as np
import pytest

from omad.evaluation.confidence.shared import shared_part

APART = np.radians(35)


@pytest.mark.parametrize("shared", [0.0, 0.3, 0.9])
def test_what_was_drawn_as_the_objects_is_found(shared):
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3, 3))
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    angle = np.arccos(np.clip(unit @ unit.transpose(0, 2, 1), -1, 1))
    of_views = np.linalg.cholesky(np.exp(-angle / APART) + 1e-9 * np.eye(3)) @ rng.normal(size=(4000, 3, 2))
    errors = np.sqrt(shared) * rng.normal(size=(4000, 1, 2)) + np.sqrt(1 - shared) * of_views
    scale = rng.lognormal(0, 0.5, (4000, 1, 1))  # some objects are harder than others
    assert shared_part(scale * errors, directions) == pytest.approx(shared, abs=0.05)


def test_views_from_one_place_tell_nothing_of_it():
    assert 0 <= shared_part(np.ones((5, 2, 1)), np.ones((5, 2, 3))) <= 1
