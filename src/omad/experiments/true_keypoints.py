"""The upper bound of Table 2: what refinement makes of the keypoints where they truly are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ..estimator import Estimator
from ..evaluation import true_pose
from ..kinematics import joint_lines, part_transforms
from ..metrics import ObjectPose
from ..object_prior import object_prior, placed
from ..objects import SampledObject
from ..priornet import PriorNet
from ..refinement import Refiner, State, Targets
from ..standard_views import View
from .predictions import Predictions, this_machine

SIGMA = 0.01
"""Category units; how surely true keypoints are held to be right, against the prior on beta."""


@torch.no_grad()
def from_true_keypoints(
    estimator: Estimator, priornet: PriorNet, models: Sequence[SampledObject], views: Sequence[View]
) -> Predictions:
    """Refine from the mean shape with the labels that OMADNet is trained on: PriorNet's keypoints of the complete
    object, carried by the true joints. ``models`` are the objects of the views, by name."""
    category, prior, unit = estimator.category, estimator.net.prior, estimator.category.metres_per_unit
    canonical = dict(zip([model.name for model in models], object_prior(priornet, models).keypoints, strict=True))
    carried = [
        placed(canonical[view.object], true_pose(view, category).T_camera_part, category.part_of_keypoint)
        for view in views
    ]
    keypoints = torch.as_tensor(np.stack(carried) / unit).float()
    targets = Targets(keypoints, torch.full(keypoints.shape[:2], SIGMA**-2))

    limits = torch.tensor([joint.limits for joint in category.joints])
    states = limits.mean(1).expand(len(views), -1)
    at_origin = torch.eye(4).expand(len(views), 4, 4)
    refiner = Refiner(prior, limits, estimator.config.refinement)
    start = refiner.placed(targets, State(prior.beta_mean.expand(len(views), -1), states, at_origin))
    found = refiner(targets, start).state
    joints = prior.joints(found.beta)
    G = part_transforms(prior.tree, joints.axes, joints.pivots, found.joint_states, found.T_camera_base)
    lines = joint_lines(prior.tree, joints.axes, joints.pivots, G)
    G[..., :3, 3] *= unit
    metric = torch.where(prior.revolute, found.joint_states, found.joint_states * unit)
    columns = (metric, lines.axes, lines.pivots * unit, G)
    poses = tuple(ObjectPose(*row) for row in zip(*(column.double().numpy() for column in columns), strict=True))
    return Predictions(poses, poses, np.full((len(views), 3), np.nan), this_machine())
