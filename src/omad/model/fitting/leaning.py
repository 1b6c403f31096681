"""Answers between what keypoints say of joint states and what the network says of them itself."""

import torch
from torch import Tensor

from ..prior import OmadPrior
from .state import Refined, Targets


def leaning(refined: Refined, states: Tensor, share: float, prior: OmadPrior, targets: Targets) -> Refined:
    """The answer with its joint states a ``share`` of the way towards other ``states`` (B, J). Shape and pose follow as
    the fit's covariance has them go along: to first order they are the likeliest ones with such joint states."""
    joints = slice(6, 6 + states.shape[1])
    among = refined.covariance[:, joints, joints]
    inverse, info = torch.linalg.inv_ex(among)
    gain = refined.covariance[:, :, joints] @ inverse
    alone = torch.zeros_like(gain[0])
    alone[joints] = torch.eye(states.shape[1]).to(gain)
    follows = (info == 0) & gain.isfinite().flatten(1).all(1)
    gain = torch.where(follows[:, None, None], gain, alone)
    state = refined.state.moved((gain @ (share * (states - refined.state.joint_states))[..., None]).squeeze(-1))
    points = prior.deform(state.beta, state.joint_states, state.T_camera_base)
    return Refined.of(state, points, targets, refined.covariance, refined.converged, refined.iterations)
