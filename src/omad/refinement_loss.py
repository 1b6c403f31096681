"""What errors of keypoints do to the refined answer.

Refinement is a weighted least squares fit, so near the truth its answer is linear in the keypoints it is given: one
Gauss-Newton step from the truth. That step is the refined answer's error, and differentiable in the keypoints at the
cost of one small linear system an observation. Trained on it, the network spends its accuracy where the answer needs
it, and makes up for what the prior cannot express.

B observations, M keypoints, J joints, |beta| D, unknowns P = 6 + J + D in the order of ``refinement``; category units.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .geometry import make_transform, so3_exp
from .keypoint_jacobian import State, keypoint_jacobian
from .kinematics import JointLines, joint_lines, part_transforms
from .prior import OmadPrior

FAR = 0.3
"""Radians and category units; an error of this size counts half, a larger one hardly more: first order says little."""


@dataclass(frozen=True)
class RefinedError:
    """To first order."""

    rotation: Tensor
    """(B, 3) rotation vector of the base."""
    translation: Tensor
    """(B, 3) of the base."""
    states: Tensor
    """(B, J)."""
    beta: Tensor
    """(B, D)."""


def refined_error(
    prior: OmadPrior, keypoints: Tensor, weights: Tensor, truth: State, whitening: Tensor
) -> RefinedError:
    """Error of the refinement's answer to ``keypoints`` (B, M, 3) of ``weights`` (B, M), in the frame of ``truth``.

    ``whitening`` (D, D) is that of the Gaussian on beta (``refinement.Refiner``); it pulls at the true beta as well.
    """
    joints, size = prior.tree.num_joints, prior.basis_size
    with torch.no_grad():
        points, jacobian = keypoint_jacobian(prior, truth)
        weighted = (weights[..., None, None] * jacobian).flatten(1, 2).double()
        hessian = weighted.mT @ jacobian.flatten(1, 2).double()
        hessian[:, 6 + joints :, 6 + joints :] += whitening.mT @ whitening
        pull = whitening.mT @ (whitening @ (prior.beta_mean - truth.beta).double().mT)
        pull = torch.nn.functional.pad(pull.mT, (6 + joints, 0))
        eye = torch.eye(6 + joints + size, dtype=torch.float64, device=hessian.device)
        inverse = torch.linalg.inv(hessian + 1e-9 * hessian.diagonal(dim1=1, dim2=2).amax(1)[:, None, None] * eye)
        lever, offset = (inverse @ weighted.mT).to(keypoints), (inverse @ pull[..., None]).squeeze(-1).to(keypoints)
    step = (lever @ (keypoints - points).flatten(1)[..., None]).squeeze(-1) + offset
    return RefinedError(*step.split((3, 3, joints, size), 1))


def axis_distance(prior: OmadPrior, truth: State, error: RefinedError, lines: JointLines) -> Tensor:
    """(B, J) distance of the refined joints' pivots from the true axes ``lines``; 0 for prismatic joints."""
    T = truth.T_camera_base
    moved = make_transform(so3_exp(error.rotation) @ T[:, :3, :3], T[:, :3, 3] + error.translation)
    joints = prior.joints(truth.beta + error.beta)
    G = part_transforms(prior.tree, joints.axes, joints.pivots, truth.joint_states + error.states, moved)
    found = joint_lines(prior.tree, joints.axes, joints.pivots, G)
    off = torch.linalg.cross(found.pivots - lines.pivots, lines.axes, dim=-1)
    return (off.square().sum(-1) + 1e-12).sqrt() * prior.revolute


def refinement_loss(error: RefinedError, distance: Tensor) -> Tensor:
    """Mean sizes of the errors in rotation, translation, joint states and axes (``distance``, (B, J)), added up; large
    ones saturate."""
    sizes = [error.rotation.square().sum(-1), error.translation.square().sum(-1), error.states.square()]
    lengths = [(squared + 1e-12).sqrt() for squared in sizes] + [distance]
    return torch.stack([(length / (1 + length / FAR)).mean() for length in lengths]).sum()
