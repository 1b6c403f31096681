"""Are training views like rendered ones? The same network must make the same error on both."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from omad.common.batches import batched
from omad.data.rendering.standard_views import standard_views
from omad.data.surface_bank import SurfaceBank
from omad.data.training_views import ViewBatch, ViewSettings, draw_views
from omad.model.network_input import first_frame, to_input_frame
from omad.model.object_prior import object_keypoints
from omad.model.omadnet import OmadNet
from omad.model.priornet import PriorNet
from omad.objects.model import ObjectModel
from omad.sensing.point_choice import choose_points
from omad.training.train_net import view_truth

BATCH = 50


@dataclass(frozen=True)
class ViewAgreement:
    """Mean keypoint distance of one network's first look, category units."""

    category: str
    views: int
    """Of each kind."""
    error_on_training_views: float
    error_on_rendered_views: float
    ratio: float
    """Training views over rendered views."""


@torch.no_grad()
def compare_views(
    net: OmadNet, priornet: PriorNet, models: Sequence[ObjectModel], views: int = 1000, seed: int = 0
) -> ViewAgreement:
    """Errors on noise-free training views and on rendered standard views of the same objects."""
    category, device = net.category, net.prior.turning.device
    bank = SurfaceBank.from_models(models, category).to(device)
    nodes = object_keypoints(priornet, bank)
    generator = torch.Generator(device).manual_seed(seed)
    settings = ViewSettings(points=net.backbone.config.points, scale=(1.0, 1.0), noise=0.0)
    drawn = (draw_views(bank, category, BATCH, settings, generator) for _ in range(0, views, BATCH))
    a, b = (
        float(torch.cat([_errors(net, batch, nodes) for batch in batches])[:views].mean())
        for batches in (drawn, _rendered(models, bank, net, views, seed))
    )
    return ViewAgreement(category.name, views, a, b, a / b)


def _errors(net: OmadNet, views: ViewBatch, nodes: torch.Tensor) -> torch.Tensor:
    """Mean keypoint distance of each view."""
    frames = first_frame(views.points)
    said = net(to_input_frame(views.points, frames)).keypoints
    true = view_truth(net, views, nodes).keypoints
    return (said - to_input_frame(true, frames)).norm(dim=-1).mean(-1)


def _rendered(
    models: Sequence[ObjectModel], bank: SurfaceBank, net: OmadNet, views: int, seed: int
) -> Iterator[ViewBatch]:
    """Standard views, each object's in turn, as batches such as training has them."""
    rng, category, count = np.random.default_rng(seed), net.category, net.backbone.config.points

    def tensor(rows: Iterable[np.ndarray]) -> torch.Tensor:
        return torch.as_tensor(np.stack(list(rows)), dtype=torch.float32, device=bank.points.device)

    for some in batched(enumerate(standard_views(models, category, views, seed)), BATCH):
        clouds = [view.observation().points for _, view in some]
        which = torch.tensor([number % len(models) for number, _ in some], device=bank.points.device)
        pose = tensor(view.T_camera_base for _, view in some)
        pose[:, :3, 3] /= category.metres_per_unit
        chosen = [choose_points(cloud, count, 1, int(rng.integers(2**63)))[0] for cloud in clouds]
        points = tensor(c[index] / category.metres_per_unit for c, index in zip(clouds, chosen, strict=True))
        yield ViewBatch(
            points=points,
            labels=torch.zeros_like(points[..., 0], dtype=torch.int64),
            states=tensor(view.states / category.state_units for _, view in some),
            T_camera_base=pose,
            axes=bank.axes[which],
            pivots=bank.pivots[which],
            indices=which,
            scale=torch.ones_like(points[:, 0]),
        )
