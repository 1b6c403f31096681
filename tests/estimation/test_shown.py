"""What is not on the object is left out, and labelled so; a clean view is looked at as ever."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import omad
from helpers.categories import LAPTOP
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.estimation.estimator import Estimator
from omad.estimation.known import Near
from omad.model.checkpoint import find_weights, load
from omad.model.omadnet import OmadNet, Prediction

BEHIND = 3.0
"""Category units between the object and the wall."""


class TellsFarPoints:
    """The shipped network, and a sure word on every point far from the cloud's median: not on the object."""

    def __init__(self, net: OmadNet) -> None:
        self.net, self.clouds = net, []

    def __call__(self, points: torch.Tensor, labels: bool = True) -> Prediction:
        said = self.net(points, labels)
        self.clouds.append(len(points))
        far = (points - points.median(1, keepdim=True).values).norm(dim=-1) > 2.0
        return replace(said, part_logits=said.part_logits + 50.0 * (far[..., None] & (torch.arange(3) == 2)) * labels)


@pytest.fixture(scope="module")
def estimator() -> Estimator:
    shipped = load(OmadNet, find_weights("laptop"))
    net = OmadNet(LAPTOP, shipped.prior, shipped.backbone.config, tells_outside=True)
    net.start_from(shipped)
    with torch.no_grad():
        net.part_out.bias[-1] = -20.0
    return Estimator(net)


@pytest.fixture
def network(estimator, monkeypatch) -> TellsFarPoints:
    network = TellsFarPoints(estimator.net)
    monkeypatch.setattr(estimator, "_forward", network)
    return network


def observe(index: int) -> omad.Observation:
    view = standard_view(generate(LAPTOP, index, "test", 7), LAPTOP, (7, index))
    return omad.Observation.from_depth(view.depth, view.camera.K)


def before_a_wall(observation: omad.Observation, first: bool = False) -> omad.Observation:
    """With a quarter as many points again, straight behind others; ``first`` or last of all."""
    some = observation.points[::4].astype(np.float64)
    depth = observation.points[:, 2].max() + BEHIND * LAPTOP.metres_per_unit
    both = [observation.points, some / some[:, 2:] * depth]
    return omad.Observation.from_points(np.concatenate(both[::-1] if first else both))


def test_a_wall_is_left_out(estimator, network):
    alone = omad.Observation.from_points(observe(0).points)
    count = len(alone.points)
    expected, found = estimator(alone), estimator(before_a_wall(alone))
    assert (found.part_labels[count:] == -1).all()
    assert (expected.part_labels >= 0).all()
    assert (found.part_labels[:count] == expected.part_labels).mean() > 0.99
    # the object's points that are left are those of the view without the wall, in the same order
    np.testing.assert_allclose(found.joint_states, expected.joint_states, atol=1e-5)
    np.testing.assert_allclose(found.keypoints, expected.keypoints, atol=1e-5)
    found = estimator(before_a_wall(alone, first=True))
    assert (found.part_labels[:-count] == -1).all()
    assert (found.part_labels[-count:] == expected.part_labels).mean() > 0.99


def test_a_clean_view_costs_no_more_looks(estimator, network):
    estimator(observe(0))
    assert network.clouds == [1, 3]
    network.clouds.clear()
    estimator([observe(0), before_a_wall(observe(1)), observe(2)])
    # the one with the wall: all its choices, the first look again, and at the end one at all of its points
    assert network.clouds == [3, 4, 1, 9, 3]


def test_a_batch_leaves_out_what_single_calls_leave_out(estimator, network):
    observations = [observe(0), before_a_wall(observe(1)), observe(2)]
    for one, observation in zip(estimator(observations), observations, strict=True):
        alone = estimator(observation)
        assert np.array_equal(one.part_labels, alone.part_labels)
        np.testing.assert_allclose(one.keypoints, alone.keypoints, atol=1e-4)


def test_tracking_leaves_it_out_too(estimator, network):
    alone = omad.Observation.from_points(observe(0).points)
    seen = estimator(alone)
    near = Near(seen.T_camera_base, seen.joint_states, seen.beta, np.eye(len(seen.beta)))
    expected, found = estimator.near(alone, near), estimator.near(before_a_wall(alone), near)
    np.testing.assert_allclose(found.joint_states, expected.joint_states, atol=1e-5)
    assert (found.part_labels[len(alone.points) :] == -1).all()


def test_where_hardly_anything_is_left_all_is_kept(estimator, monkeypatch):
    def nothing_there(points: torch.Tensor, labels: bool = True) -> Prediction:
        said = estimator.net(points, labels)
        return replace(said, part_logits=said.part_logits + 50.0 * (torch.arange(3) == 2))

    monkeypatch.setattr(estimator, "_forward", nothing_there)
    estimate = estimator(observe(0))
    assert (estimate.part_labels == -1).all()
    assert np.isfinite(estimate.keypoints).all()


def test_points_outside_are_counted_to_no_part(estimator, network):
    alone = omad.Observation.from_points(observe(0).points)
    parts = estimator(before_a_wall(alone)).to_dict()["parts"]
    assert sum(part["points"] for part in parts) == len(alone.points)


def test_a_network_that_tells_no_outside_answers_as_before(estimator):
    """A class more that never wins changes nothing."""
    shipped = Estimator.from_pretrained("laptop", device="cpu")
    observation = observe(3)
    np.testing.assert_allclose(estimator(observation).keypoints, shipped(observation).keypoints, atol=1e-5)
