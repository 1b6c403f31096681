"""Whether two models are the same object."""

import numpy as np

from omad.objects.model import ObjectModel

from .kinematics_by_yourdfpy import largest_gap


def assert_same(ours: ObjectModel, truth: ObjectModel, metres: float, radians: float) -> None:
    assert ours.part_names == truth.part_names
    assert ours.tree == truth.tree
    for fraction in (0.0, 0.4, 1.0):
        state = truth.limits[:, 0] + fraction * np.ptp(truth.limits, axis=1)
        for a, b in zip(ours.posed_vertices(state), truth.posed_vertices(state), strict=True):
            assert largest_gap(a, b) < metres
    np.testing.assert_allclose(ours.limits, truth.limits, atol=radians)
