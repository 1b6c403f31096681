"""Do keypoints correspond? On objects whose semantic places are known, say how far each keypoint's place wanders."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from omad.data.surface_bank import SurfaceBank
from omad.geometry.transforms import point_to_line
from omad.model.object_prior import object_keypoints
from omad.model.priornet import PriorNet
from omad.objects.model import ObjectModel


@dataclass(frozen=True)
class KeypointSpread:
    """Lengths in category units. A place is where a keypoint lies inside its part's box, as shares of its sides."""

    category: str
    objects: int
    wander: list[float]
    """(M,) mean distance of each keypoint from its mean place, over objects."""
    mean_wander: float
    model_error: float
    """Mean distance between the nodes found on an object and the nearest keypoints that the basis can make."""
    pivot_error: float | None
    """Mean distance of the joint function's pivots from the true axes, of joints that turn; None where none does."""


@torch.no_grad()
def keypoint_spread(net: PriorNet, models: Sequence[ObjectModel]) -> KeypointSpread:
    """Measure a trained PriorNet on objects that it was not trained on."""
    bank = SurfaceBank.from_models(models, net.category).to(net.part_of.device)
    nodes = object_keypoints(net, bank)
    beta = net.prior.encode(nodes)
    keypoints, joints = net.prior.keypoints(beta), net.prior.joints(beta)
    boxes = torch.stack([torch.as_tensor(m.part_boxes() / net.category.metres_per_unit) for m in models]).to(nodes)
    low, high = boxes[:, net.part_of, 0], boxes[:, net.part_of, 1]
    place = (keypoints - low) / (high - low)
    wander = ((place - place.mean(0)) * (high - low)).norm(dim=-1).mean(0)
    off = point_to_line(joints.pivots, bank.axes, bank.pivots)[:, net.prior.turning]
    return KeypointSpread(
        category=net.category.name,
        objects=len(models),
        wander=wander.tolist(),
        mean_wander=float(wander.mean()),
        model_error=float((keypoints - nodes).norm(dim=-1).mean()),
        pivot_error=float(off.mean()) if off.numel() else None,
    )
