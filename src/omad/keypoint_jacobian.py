"""Camera-space keypoints of a state and their derivative by its unknowns, in closed form.

Unknowns in the order of ``refinement``: omega (3) and t (3) of the base in camera axes, theta (J), beta (D);
P = 6 + J + D. Category units and radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .geometry import skew
from .kinematics import part_transforms
from .prior import OmadPrior


@dataclass(frozen=True)
class State:
    """The unknowns of B observations."""

    beta: Tensor
    """(B, D)."""
    joint_states: Tensor
    """(B, J)."""
    T_camera_base: Tensor
    """(B, 4, 4)."""


def keypoint_jacobian(prior: OmadPrior, state: State) -> tuple[Tensor, Tensor]:
    """Camera-space keypoints (B, M, 3) and their derivative (B, M, 3, P) by the unknowns."""
    tree, part_of, basis = prior.tree, prior.part_of, prior.basis
    joints = prior.joints(state.beta)
    axes, pivots = joints.axes, joints.pivots
    d_axes, d_pivots = _joint_derivatives(prior, state.beta)  # (B, J, 3, D)
    R, t = state.T_camera_base[:, :3, :3], state.T_camera_base[:, :3, 3]
    batch, count = len(R), tree.num_joints
    eye = torch.eye(4, dtype=R.dtype, device=R.device).expand(batch, 4, 4)
    G = part_transforms(tree, axes, pivots, state.joint_states, eye)  # part -> base frame
    canonical = prior.keypoints(state.beta)

    A = G[:, part_of, :3, :3]
    points = (A @ canonical[..., None]).squeeze(-1) + G[:, part_of, :3, 3]  # base frame
    by_states = torch.zeros(*points.shape, count, dtype=R.dtype, device=R.device)
    by_beta = torch.einsum("bmij,mjd->bmid", A, basis)
    for part in range(1, tree.num_parts):
        members = prior.keypoints_of_part[part]
        below = canonical[:, members]  # the keypoint in canonical coordinates, before the joint at hand moves it
        for joint in reversed(tree.path(part)):
            parent = G[:, tree.parents[joint]]
            rotation = parent[:, :3, :3]
            theta = state.joint_states[:, joint, None, None]
            u, q = axes[:, joint], pivots[:, joint]
            if tree.types[joint] == "revolute":
                arm = below - q[:, None]
                cos, sin = theta.cos(), theta.sin()
                along = (arm * u[:, None]).sum(-1, keepdim=True)
                turned = (
                    cos * arm
                    + sin * torch.linalg.cross(u[:, None].expand_as(arm), arm)
                    + (1 - cos) * along * u[:, None]
                )
                by_u = -sin[..., None] * skew(arm) + (1 - cos)[..., None] * (
                    along[..., None] * torch.eye(3, dtype=R.dtype, device=R.device)
                    + u[:, None, :, None] * arm[..., None, :]
                )
                eye3 = torch.eye(3, dtype=R.dtype, device=R.device)
                F = cos * eye3 + sin * skew(u) + (1 - cos) * u[..., None] * u[:, None]
                moved = turned + q[:, None]
                d_theta = torch.linalg.cross(u[:, None].expand_as(arm), turned)
                d_beta = by_u @ d_axes[:, None, joint] + ((eye3 - F) @ d_pivots[:, joint])[:, None]
            else:
                moved = below + theta * u[:, None]
                d_theta = u[:, None].expand_as(below)
                d_beta = (theta * d_axes[:, joint])[:, None].expand(-1, below.shape[1], -1, -1)
            by_states[:, members, :, joint] = d_theta @ rotation.mT
            by_beta[:, members] += rotation[:, None] @ d_beta
            below = moved
    camera = points @ R.mT
    d_omega = -skew(camera)
    d_t = torch.eye(3, dtype=R.dtype, device=R.device).expand_as(d_omega)
    moving = R[:, None] @ torch.cat([by_states, by_beta], -1)
    return camera + t[:, None], torch.cat([d_omega, d_t, moving], -1)


def _joint_derivatives(prior: OmadPrior, beta: Tensor) -> tuple[Tensor, Tensor]:
    """d axis / d beta and d pivot / d beta, each (B, J, 3, D)."""
    hidden = prior.joint_hidden(beta)
    active = (hidden > 0).to(beta.dtype)
    raw = prior.joint_out(hidden.relu()).unflatten(-1, (-1, 6))
    slope = prior.joint_out.weight @ (active[..., None] * prior.joint_hidden.weight)
    slope = slope.unflatten(1, (-1, 6))
    unnormalised = prior.nominal_axes + raw[..., :3]
    length = unnormalised.norm(dim=-1, keepdim=True)
    axis = unnormalised / length
    eye = torch.eye(3, dtype=beta.dtype, device=beta.device)
    tangent = (eye - axis[..., None] * axis[..., None, :]) / length[..., None]
    return tangent @ slope[:, :, :3], slope[:, :, 3:] * prior.revolute[:, None, None]
