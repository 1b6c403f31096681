"""The refined answer's error to first order: what refinement does, and what the network is taught by it."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.categories import EYEGLASSES, LAPTOP
from helpers.scenes import CASES, Scene, scene
from omad.geometry.kinematics import JointLines, joint_lines, part_transforms
from omad.geometry.transforms import point_to_line
from omad.model.fitting.energy import RefinementConfig, ShapePrior
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import Targets
from omad.objects.category import Category
from omad.training.refined_error import FAR, RefinedError, axis_distance, refined_error, refinement_loss


def belief(s: Scene, weight: float) -> ShapePrior:
    return ShapePrior.of(s.prior.beta_mean, s.prior.beta_covariance, weight)


def errors(s: Scene, noise: Tensor, prior_weight: float) -> tuple[Tensor, Tensor]:
    """Of a refinement that begins at the truth, and the same to first order; (B, 6 + J)."""
    refiner = Refiner(
        s.prior,
        s.limits,
        RefinementConfig(prior_weight=prior_weight, huber=None, step_tolerance=1e-11, cost_tolerance=0.0),
    )
    targets = Targets(s.targets.keypoints + noise, s.targets.weights)
    found, truth = refiner(targets, s.truth).state, s.truth
    turn = found.T_camera_base[:, :3, :3] @ truth.T_camera_base[:, :3, :3].mT
    turn = (turn - turn.mT) / 2
    omega = torch.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], 1)  # small angles
    moved = (found.T_camera_base - truth.T_camera_base)[:, :3, 3]
    said = refined_error(s.prior, targets.keypoints, targets.weights, truth, belief(s, prior_weight))
    return (
        torch.cat([omega, moved, found.joint_states - truth.joint_states], 1),
        torch.cat([said.rotation, said.translation, said.states], 1),
    )


def lines_of(s: Scene) -> JointLines:
    joints, tree = s.prior.joints(s.truth.beta), s.prior.tree
    G = part_transforms(tree, joints.axes, joints.pivots, s.truth.joint_states, s.truth.T_camera_base)
    return joint_lines(tree, joints.axes, joints.pivots, G)


@pytest.mark.parametrize("category", CASES, ids=lambda category: category.name)
@pytest.mark.parametrize("cause", ["noise", "prior"])
def test_first_order_error_of_the_refinement(category: Category, cause: str) -> None:
    s = scene(category, batch=6)
    unit = torch.randn(s.targets.keypoints.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    left_out = []
    for share in (1.0, 0.5):
        noise, weight = (share * 1e-3 * unit, 1e-9) if cause == "noise" else (0 * unit, share)
        exact, first_order = errors(s, noise, weight)
        assert (exact - first_order).norm() < 0.1 * exact.norm()
        left_out.append(float((exact - first_order).norm()))
    assert left_out[1] < 0.35 * left_out[0]  # what first order leaves out is of second order


def test_loss_falls_along_its_gradient_and_is_nothing_at_the_truth() -> None:
    s = scene(LAPTOP, batch=4)
    none = ShapePrior(s.prior.beta_mean, torch.zeros(s.prior.basis_size, s.prior.basis_size, dtype=torch.float64))

    def loss(keypoints: Tensor) -> Tensor:
        error = refined_error(s.prior, keypoints, s.targets.weights, s.truth, none)
        return refinement_loss(error, axis_distance(s.prior, s.truth, error, lines_of(s)))

    assert loss(s.targets.keypoints) < 1e-4
    keypoints = (s.targets.keypoints + 0.01 * torch.randn_like(s.targets.keypoints)).requires_grad_()
    before = loss(keypoints)
    (gradient,) = torch.autograd.grad(before, keypoints)
    assert loss(keypoints - 1e-3 * gradient / gradient.norm()) < before


def test_axes_are_as_far_off_as_those_of_the_refined_answer() -> None:
    s = scene(EYEGLASSES, batch=6)
    refiner = Refiner(s.prior, s.limits, RefinementConfig(prior_weight=1e-9, huber=None))
    targets = Targets(s.targets.keypoints + 1e-3 * torch.randn_like(s.targets.keypoints), s.targets.weights)
    error = refined_error(s.prior, targets.keypoints, targets.weights, s.truth, belief(s, 1e-9))
    lines = lines_of(replace(s, truth=refiner(targets, s.truth).state))
    true = lines_of(s)
    expected = point_to_line(lines.pivots, true.axes, true.pivots)
    torch.testing.assert_close(axis_distance(s.prior, s.truth, error, true), expected, atol=2e-5, rtol=0.05)


def test_loss_adds_up_mean_sizes_and_saturates() -> None:
    rotation, translation = torch.tensor([[0.6, 0.8, 0.0]]), torch.tensor([[0.0, 0.0, 2.0]])

    def of(size: float) -> float:
        error = RefinedError(size * rotation, size * translation, size * torch.tensor([[-1.0, 3.0]]), torch.ones(1, 5))
        return refinement_loss(error, size * torch.tensor([[4.0, 6.0]])).item()

    assert of(1e-3) == pytest.approx(1e-3 * (1 + 2 + 2 + 5), rel=0.03)
    assert of(1e3) == pytest.approx(4 * FAR, rel=0.01)
