"""What errors of keypoints do to the refined answer.

Refinement is a weighted least squares fit, so near the truth its answer is linear in the keypoints it is given: one
Gauss-Newton step from the truth. That step is the refined answer's error, and differentiable in the keypoints at the
cost of one small linear system an observation. Trained on it, the network spends its accuracy where the answer needs
it, and makes up for what the prior cannot express.

B observations, M keypoints, J joints, |beta| D; unknowns P = 6 + J + D in the order of ``fitting.state``. Category
units.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from omad.geometry.kinematics import JointLines, joint_lines, part_transforms
from omad.geometry.least_squares import Linearisation, normal_equations
from omad.model.fitting.energy import ShapePrior, linearise
from omad.model.fitting.state import State, Targets
from omad.model.prior import OmadPrior

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
    prior: OmadPrior, keypoints: Tensor, weights: Tensor, truth: State, shape_prior: ShapePrior
) -> RefinedError:
    """Error of the refinement's answer to ``keypoints`` (B, M, 3) of ``weights`` (B, M), in the frame of ``truth``.
    ``shape_prior``, the Gaussian on beta, pulls at the true beta as well."""
    at = linearise(prior, truth, Targets(keypoints, weights), shape_prior)
    normal = normal_equations(Linearisation(at.residuals.double(), at.jacobian.double()))
    with torch.no_grad():
        eye = torch.eye(normal.hessian.shape[-1]).to(normal.hessian)
        floor = 1e-9 * normal.hessian.diagonal(dim1=1, dim2=2).amax(1)[:, None, None]
        inverse = torch.linalg.inv(normal.hessian + floor * eye)
    step = -(inverse @ normal.gradient[..., None]).squeeze(-1).to(keypoints)
    return RefinedError(*step.split((3, 3, prior.tree.num_joints, prior.basis_size), 1))


def axis_distance(prior: OmadPrior, truth: State, error: RefinedError, lines: JointLines) -> Tensor:
    """(B, J) distance of the refined joints' pivots from the true axes ``lines``; 0 where an axis has no place."""
    found = truth.moved(torch.cat([error.rotation, error.translation, error.states, error.beta], 1))
    joints = prior.joints(found.beta)
    G = part_transforms(prior.tree, joints.axes, joints.pivots, found.joint_states, found.T_camera_base)
    axes = joint_lines(prior.tree, joints.axes, joints.pivots, G)
    off = torch.linalg.cross(axes.pivots - lines.pivots, lines.axes, dim=-1)
    return (off.square().sum(-1) + 1e-12).sqrt() * prior.turning


def refinement_loss(error: RefinedError, distance: Tensor) -> Tensor:
    """Mean sizes of the errors in rotation, translation, joint states and axes (``distance``, (B, J)), added up; large
    ones saturate."""
    sizes = [error.rotation.square().sum(-1), error.translation.square().sum(-1), error.states.square()]
    lengths = [(squared + 1e-12).sqrt() for squared in sizes] + [distance]
    return torch.stack([(length / (1 + length / FAR)).mean() for length in lengths]).sum()
