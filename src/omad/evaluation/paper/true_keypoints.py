"""The upper bound of Table 2: what refinement makes of the keypoints where they truly are."""

from collections.abc import Sequence

import numpy as np
import torch

from omad.data.rendering.standard_views import View, true_pose
from omad.estimation.estimator import Estimator
from omad.geometry.rigid import carry_each
from omad.model.fitting.posed_object import posed_objects
from omad.model.fitting.refinement import Refiner
from omad.model.fitting.state import State, Targets
from omad.model.object_prior import object_prior
from omad.model.priornet import PriorNet
from omad.objects.model import SampledObject
from omad.objects.pose import ObjectPose

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
    part_of = list(category.part_of_keypoint)
    carried = [carry_each(true_pose(v, category).T_camera_part[part_of], canonical[v.object]) for v in views]
    keypoints = torch.as_tensor(np.stack(carried) / unit).float()
    targets = Targets(keypoints, torch.full(keypoints.shape[:2], SIGMA**-2))

    limits, count = torch.as_tensor(category.limits).float(), len(views)
    refiner = Refiner(prior, limits, estimator.config.refinement)
    mean = State(prior.beta_mean.expand(count, -1), limits.mean(1).expand(count, -1), torch.eye(4).expand(count, 4, 4))
    found = refiner(targets, refiner.with_fitted_pose(targets, mean)).state
    poses = ObjectPose.stack([posed.placed for posed in posed_objects(prior, category, found)])
    return Predictions(poses, poses, np.full((count, 3), np.nan), this_machine())
