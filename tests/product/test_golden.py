"""Shipped weights on a small committed benchmark: clouds of unseen procedural objects, half of them noisy."""

from functools import cache

import numpy as np
import pytest

from helpers.categories import CATEGORIES
from helpers.golden import golden
from omad.data.procedural import generate
from omad.data.rendering.spoils.spoil import Spoil
from omad.data.source import load_views
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.evaluation.keypoint_spread import keypoint_spread
from omad.evaluation.metrics import pose_errors
from omad.evaluation.robustness.experiment import measure, scenes_from
from omad.evaluation.robustness.rows import CLEAN, ROWS, Row
from omad.evaluation.view_agreement import compare_views
from omad.model.checkpoint import find_weights, load, shipped_categories
from omad.model.omadnet import OmadNet
from omad.model.priornet import PriorNet
from omad.objects.pose import ObjectPose

# Of answers that are not passed over:
# mean joint state error (degrees, or category units), mean axis error in degrees, mean axis distance in category units
LIMITS = {
    "cabinet_one_door": (1.4, 0.85, 0.024),
    "cabinet_two_doors": (2.7, 1.2, 0.019),
    "desk_lamp": (2.9, 1.25, 0.023),
    "dishwasher": (1.8, 0.75, 0.041),
    "drawer": (0.05, 1.05, None),
    "drawer_1": (0.04, 1.0, None),
    "drawer_2": (0.044, 1.15, None),
    "drawer_4": (0.055, 0.8, None),
    "drawer_5": (0.061, 0.95, None),
    "eyeglasses": (2.7, 2.55, 0.015),
    "laptop": (1.1, 0.7, 0.025),
    "lidded_box": (2.1, 1.1, 0.025),
    "microwave": (1.2, 0.95, 0.028),
    "oven": (1.8, 1.1, 0.042),
    "pliers": (1.9, 0.9, 0.019),
    "refrigerator": (1.35, 0.9, 0.023),
    "refrigerator_two_doors": (2.6, 0.75, 0.016),
    "safe": (1.4, 0.75, 0.027),
    "scissors": (2.4, 1.6, 0.015),
    "stapler": (2.2, 0.95, 0.068),
    "suitcase": (3.2, 1.0, 0.015),
    "trash_can": (2.3, 3.2, 0.038),
    "washing_machine": (2.3, 1.4, 0.028),
}
PASSED_OVER = {"cabinet_one_door": 6, "desk_lamp": 3, "drawer_5": 5}
"""Of 24 answers, at most so many are doubtful, or take the object for one of the other hand; 1 of other categories. Of
these at most ``DOUBTED_IN_VAIN`` are right. Of cabinets with one door there are 150, as two shut doors among 24 decide
how far axes are off, 48 of staplers, whose magazine has no visible hinge, of desk lamps, whose head is small, and of
refrigerators with two doors, whose states differ by a tenth from one 24 to the next, as axes do of chests of three
drawers, of which there are 60, and 40 of suitcases, one of which is 40 degrees off without being doubtful."""
DOUBTED_IN_VAIN = {"cabinet_one_door": 3}
RIGHT = 10, 0.1
"""Errors in degrees and category units of joint states up to which an answer is right."""


@pytest.fixture(scope="module", params=sorted(CATEGORIES))
def name(request) -> str:
    return request.param


@cache
def answered(name: str) -> tuple[list[Estimate], dict[str, np.ndarray]]:
    """Answers to the benchmark of a category, and what its file holds."""
    views, data = golden(name)
    return Estimator.from_pretrained(name, device="cpu")(views), data


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_categories())
def test_errors_stay_below_the_stated_ones(name):
    estimates, data = answered(name)
    category = estimates[0].category
    unit, revolute = category.metres_per_unit, category.turning
    found, in_vain = [], 0
    for i, estimate in enumerate(estimates):
        truth = ObjectPose(data["states"][i], data["axes"][i], data["pivots"][i], data["T_camera_part"][i])
        errors = pose_errors(estimate.pose(), truth, data["part_boxes"][i], category)
        if not (estimate.doubtful or estimate.of_other_hand):
            found.append(errors)
        elif not estimate.of_other_hand:
            off = np.array(errors.joint_state)
            in_vain += bool(np.where(revolute, np.degrees(off) < RIGHT[0], off / unit < RIGHT[1]).all())
    assert len(found) >= len(estimates) - PASSED_OVER.get(name, 1)
    assert in_vain <= DOUBTED_IN_VAIN.get(name, 1)
    state = np.array([e.joint_state for e in found])
    axis = np.degrees([e.axis for e in found])
    distance = np.array([e.axis_distance for e in found]) / unit
    means = np.where(revolute, np.degrees(state), state / unit).mean(), axis.mean(), distance.mean()
    for mean, limit in zip(means, LIMITS[name], strict=True):
        assert limit is None or mean <= limit, means
    assert np.median(axis) < 3.0
    assert sum(estimate.converged for estimate in estimates) >= len(estimates) - 1


@pytest.mark.slow
def test_refinement_improves_on_the_network(name):
    estimates, data = answered(name)
    states = data["states"]
    initial = np.mean(
        [
            [abs(j.state - s) for j, s in zip(e.initial.joints, t, strict=True)]
            for e, t in zip(estimates, states, strict=True)
        ]
    )
    refined = np.mean(
        [[abs(j.state - s) for j, s in zip(e.joints, t, strict=True)] for e, t in zip(estimates, states, strict=True)]
    )
    assert refined < 0.85 * initial


@pytest.mark.slow
def test_keypoints_correspond_between_unseen_objects(name):
    net = load(PriorNet, find_weights(name) / "prior")
    spread = keypoint_spread(net, [generate(net.category, i, "test", 3) for i in range(40)])
    assert spread.mean_wander < 0.05
    # since there are chests of trays, chests differ in more ways than beta has numbers
    assert spread.model_error < (0.035 if name == "drawer" else 0.03)
    assert (spread.pivot_error is None) == (not any(net.category.turning))
    assert spread.pivot_error is None or spread.pivot_error < 0.07


@pytest.mark.slow
@pytest.mark.parametrize("name", ["laptop", "eyeglasses", "drawer"])
def test_training_views_are_like_rendered_ones(name):
    folder = find_weights(name)
    net = load(OmadNet, folder)
    models = [generate(net.category, i, "test", 3) for i in range(20)]
    agreement = compare_views(net, load(PriorNet, folder / "prior"), models, views=300)
    assert 0.8 < agreement.ratio < 1.1, agreement  # docs/results.md says how far it is from one, and why


# mean joint state error, degrees or category units: of exact masks, and of masks 3 px too wide by a wall and on a table
SLOPPY = {
    "laptop": (1.8, 2.2),
    "eyeglasses": (4.0, 5.5),
    "dishwasher": (5.0, 6.0),
    "scissors": (4.0, 7.0),
    "drawer": (0.08, 0.10),
}


@pytest.mark.slow
def test_sloppy_masks_hardly_matter(name):
    estimator = Estimator.from_pretrained(name, device="cpu")
    category, rows = estimator.category, {row: ROWS[row] for row in (CLEAN, "wide-3-wall", "wide-3-table")}
    source = load_views("procedural", category, 10, 20, 3, "off", "refuse")
    found = measure(estimator, scenes_from(source, category, 3), 20, rows)
    unit = np.pi / 180 if all(category.turning) else category.metres_per_unit
    mean = {row: np.mean([each.errors.joint_state for each in views]) / unit for row, views in found.items()}
    exact, sloppy = SLOPPY[name]
    assert mean[CLEAN] < exact, mean
    assert max(mean["wide-3-wall"], mean["wide-3-table"]) < sloppy, mean


# share of answers that are wrong and not doubted, of masks that leave out a part of the object
BELIEVED = {"laptop": 0.2, "scissors": 0.35}
PART_MISSED = {"without a part": Row("a mask without a part", Spoil(part_missed=True))}


@pytest.mark.slow
@pytest.mark.parametrize("name", BELIEVED)
def test_answers_to_masks_without_a_part_are_doubted(name):
    estimator = Estimator.from_pretrained(name, device="cpu")
    source = load_views("procedural", estimator.category, 20, 40, 3, "off", "refuse")
    [found] = measure(estimator, scenes_from(source, estimator.category, 3), 40, PART_MISSED).values()
    assert np.mean([one.wrong for one in found]) > 0.5  # how much of the object is out of sight, no answer can know
    assert np.mean([one.wrong and not one.flagged for one in found]) < BELIEVED[name]
