"""Losses against closed forms."""

import math

import pytest
import torch

from omad.training import losses

PART = torch.tensor([0, 0, 1, 1])
PARTS = (slice(0, 2), slice(2, 4))


def keypoints() -> torch.Tensor:
    return torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 2, 1]]])


def test_chamfer_is_zero_on_itself_and_sees_only_its_own_part():
    a = keypoints()
    assert losses.part_chamfer(a, a, PARTS) == pytest.approx(0, abs=1e-5)
    b = a.clone()
    b[0, 2:] += torch.tensor([0.0, 0.0, 0.25])
    # part 1: each keypoint is 0.25 away both ways; part 0: nothing; mean over four keypoints, two directions
    assert losses.part_chamfer(a, b, PARTS) == pytest.approx(0.25, abs=1e-4)


def test_surface_loss_is_one_sided_and_part_level():
    clouds = torch.tensor([[[0.0, 0, 0.3], [1, 0, 0.3], [5, 5, 5]]]), torch.tensor([[[0.0, 2, 0.5]]])
    expected = (0.3 + 0.3 + 0.5 + 0.5) / 4
    assert losses.surface_loss(keypoints(), PARTS, clouds) == pytest.approx(expected, abs=1e-5)


def test_coverage_is_zero_when_keypoints_span_the_box():
    low, high = losses.part_boxes([keypoints()[:, of] for of in PARTS])
    # flat directions count as at least 0.02 thick, which the keypoints cannot span: only those may cost
    box = torch.tensor([[[0.0, 0, 0], [0.0, 2, 0]]]), torch.tensor([[[1.0, 0, 0], [0.0, 2, 1]]])
    assert torch.equal(low, box[0])
    assert torch.equal(high, box[1])
    corners = torch.tensor([[[0.0, 0, 0], [1, 1, 1]]])
    part = (slice(0, 2),)
    exact = losses.coverage_loss(corners, part, torch.zeros(1, 1, 3), torch.ones(1, 1, 3))
    short = losses.coverage_loss(corners * 0.5, part, torch.zeros(1, 1, 3), torch.ones(1, 1, 3))
    assert exact == pytest.approx(0, abs=1e-6)
    assert short > 0.3


def test_separation_is_a_hinge_at_a_share_of_the_diagonal():
    points = torch.tensor([[[0.0, 0, 0], [0.1, 0, 0]]])
    part = torch.tensor([0, 0])
    low, high = torch.zeros(1, 1, 3), torch.tensor([[[3.0, 4.0, 0.0]]])
    assert losses.separation_loss(points, part, low, high, share=0.1) == pytest.approx(0.4, abs=1e-5)
    assert losses.separation_loss(points, part, low, high, share=0.02) == pytest.approx(0, abs=1e-6)


def test_joint_loss_measures_to_the_line_and_ignores_prismatic_pivots():
    axes = torch.tensor([[[1.0, 0, 0], [0, 0, 1.0]]])
    pivots = torch.tensor([[[7.0, 0.3, 0.4], [9.0, 9, 9]]])
    revolute = torch.tensor([True, False])
    value = losses.joint_loss(axes, pivots, axes, torch.zeros(1, 2, 3), revolute)
    assert value == pytest.approx(0.5 / 2, abs=1e-6)
    opposite = losses.joint_loss(-axes, torch.zeros(1, 2, 3), axes, torch.zeros(1, 2, 3), revolute)
    assert opposite == pytest.approx(1.0, abs=1e-6)


def test_quaternion_loss_is_blind_to_sign():
    q = torch.nn.functional.normalize(torch.tensor([[0.3, -0.2, 0.9, 0.1]]), dim=-1)
    assert losses.quaternion_loss(-q, q) == pytest.approx(0, abs=1e-6)


def test_state_loss_keeps_angles_and_lengths_apart():
    value = losses.state_loss(torch.tensor([[math.pi / 2, 0.2]]), torch.zeros(1, 2), torch.tensor([True, False]))
    assert value == pytest.approx((0.25 + 0.04) / 2)


def test_confidence_is_best_at_the_true_spread():
    error = 0.05 * torch.randn(20000, 1, 3, generator=torch.Generator().manual_seed(0))
    distance = error.norm(dim=-1)
    values = {
        s: float(losses.confidence_loss(distance, torch.full_like(distance, math.log(s)))) for s in (0.04, 0.05, 0.0625)
    }
    assert min(values, key=values.__getitem__) == 0.05


def test_segmentation_counts_points_outside_the_object_more():
    logits = torch.tensor([[[2.0, 0.0, 1.0], [0.0, 1.0, 3.0], [1.0, 1.0, 1.0]]])
    labels = torch.tensor([[0, 2, 1]])
    each = -torch.log_softmax(logits, -1)[0, torch.arange(3), labels[0]]
    expected = (each[0] + 4 * each[1] + each[2]) / 6
    assert losses.segmentation_loss(logits, labels, 2, 4.0) == pytest.approx(expected.item(), rel=1e-6)
    parts_only = losses.segmentation_loss(logits, labels, 3, 4.0)
    assert parts_only == pytest.approx(each.mean().item(), rel=1e-6)


def test_hands_are_told_by_comparison():
    draw = torch.Generator().manual_seed(0)
    own, image = (torch.randn(5, 6, generator=draw) for _ in range(2))
    alike = losses.hand_loss(own, own)
    assert alike == pytest.approx(math.log(2))  # a coin's
    signs = torch.tensor([1.0, -1.0] * 3)
    odds = (own - image) @ signs / math.sqrt(6)
    assert losses.hand_loss(own, image) == pytest.approx(-torch.sigmoid(odds).log().mean().item(), rel=1e-6)
    better = losses.hand_loss(own + signs, image - signs)
    assert better < losses.hand_loss(own, image)
