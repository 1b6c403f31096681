"""The bank of a category's surfaces: objects whose keypoints a prior finds."""

from collections.abc import Sequence

import torch

from omad.common.batches import batched, progress
from omad.data.surface_bank import SurfaceBank
from omad.model.object_prior import object_keypoints
from omad.model.priornet import PriorNet
from omad.model.surfaces.bank import ShapeBank
from omad.objects.model import ObjectModel

BATCH = 50
"""Objects whose samples are in memory together."""


@torch.no_grad()
def surface_bank(net: PriorNet, models: Sequence[ObjectModel], generated: bool) -> ShapeBank:
    """Of ``models``; ``generated``: they are the first that the category's generator makes to train with, and need not
    be kept."""
    known = []
    for some in batched(progress(models, len(models)), BATCH):
        known.append(object_keypoints(net, SurfaceBank.from_models(some, net.category).to(net.part_of.device)))
    return ShapeBank.of_models(net.category, net.prior, torch.cat(known), models, generated)
