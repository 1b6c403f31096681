"""What other answers to the same observation say against one: less likely ones less, and only what leans far."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import omad
from helpers.categories import LAPTOP
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.estimation.checks.other_answers import BETTER, LYING, camera_doubts, gravity_doubts
from omad.estimation.known import NOTHING_KNOWN
from omad.geometry.rigid import rigid


@pytest.fixture(scope="module")
def seen() -> omad.Observation:
    return standard_view(generate(LAPTOP, 2, "test"), LAPTOP, (5, 2)).observation()


@pytest.fixture(scope="module")
def estimate(seen) -> omad.Estimate:
    return omad.Estimator.from_pretrained("laptop", "cpu")(seen)


@pytest.mark.parametrize(("probability", "told"), [(0.9, ["intrinsics"]), (0.5, []), (0.02, [])])
def test_a_focal_length_counts_where_its_answer_is_as_likely(seen, estimate, probability, told):
    """Odds of 9 to 1 and 49 times worse ones: it would have to fit better by as much."""
    sure = replace(estimate, probability=0.9)
    better = replace(estimate, residual=estimate.residual / (1.5 * BETTER), probability=probability)
    found = camera_doubts(seen, sure, lambda views: [better] * len(views))
    assert [check.name for check in found] == told


@pytest.mark.parametrize("degrees", [-60, -1, 1, 60])
def test_what_leans_further_than_views_are_rolled_seems_to_lie(seen, estimate, degrees):
    most = np.degrees(LAPTOP.views.roll) + LYING
    leaning = most + degrees if degrees > 0 else most - abs(degrees)
    turn = rigid(Rotation.from_rotvec([0, 0, np.radians(leaning)]).as_matrix(), np.zeros(3))
    upright = np.diag([1.0, -1.0, -1.0, 1.0])
    upright[2, 3] = 1.0
    T = np.repeat((turn @ upright)[None], len(estimate.T_camera_part), 0)
    leant = replace(estimate, placed=replace(estimate.placed, T_camera_part=T))
    found = gravity_doubts(seen, leant, NOTHING_KNOWN, lambda *_: pytest.fail("nothing is asked"))
    assert [check.name for check in found] == (["gravity"] if degrees > 0 else [])
