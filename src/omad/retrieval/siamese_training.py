"""Train the Siamese network on pairs of the views that OMADNet is trained on, by the same loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from ..categories import Category
from ..objects import SampledObject
from ..omadnet import OmadNet, first_frame, to_input_frame
from ..pointnet2 import SLIM, BackboneConfig
from ..train_net import NetTraining
from ..training import Schedule, train
from ..viewpoints import uniform
from ..views import SurfaceBank, ViewSettings, draw_views_of
from .siamese import MARGIN, SiameseNet, contrastive_losses

_OMADNET = NetTraining()


@dataclass(frozen=True)
class SiameseTraining:
    """Settings of the Siamese network's training; budget, backbone and views are OMADNet's."""

    schedule: Schedule = _OMADNET.schedule
    backbone: BackboneConfig = SLIM
    views: ViewSettings = _OMADNET.views
    views_of_object: int = 2
    """In a batch, with the same stretch; the rest of the batch are views of other objects."""
    margin: float = MARGIN


def train_siamese(
    models: Sequence[SampledObject],
    category: Category,
    folder: Path,
    settings: SiameseTraining,
    device: torch.device | str = "cpu",
    initial: OmadNet | None = None,
) -> SiameseNet:
    """Train on views of ``models``, its backbone from that of ``initial`` where given; returns the averaged
    network. ``folder`` as ``omad.training.train``."""
    torch.manual_seed(settings.schedule.seed)  # initial weights
    bank = SurfaceBank.from_models(models, category, seed=settings.schedule.seed).to(device)
    net = SiameseNet(category, settings.backbone).to(device)
    if initial is not None:
        net.backbone.load_state_dict(initial.backbone.state_dict())
    each = settings.views_of_object
    drawn = -(-settings.schedule.batch // each)

    def loss_terms(module: torch.nn.Module, draw: torch.Generator) -> dict[str, Tensor]:
        assert isinstance(module, SiameseNet)
        with torch.no_grad():
            like = bank.points
            chosen = torch.randint(len(bank), (drawn,), device=like.device, generator=draw)
            scale = uniform(*settings.views.scale, (drawn, 3), like, draw)
            # an object drawn twice is stretched twice: another object
            objects = torch.arange(drawn, device=like.device).repeat_interleave(each)[: settings.schedule.batch]
            views = draw_views_of(bank, category, chosen[objects], scale[objects], settings.views, draw)
            points = to_input_frame(views.points, first_frame(views.points))
        return contrastive_losses(module(points), objects, settings.margin)

    config = {"kind": "siamese", "category": asdict(category), "objects": [m.name for m in models]}
    config |= {"backbone": asdict(settings.backbone), "views": asdict(settings.views)}
    config |= {"views_of_object": each, "margin": settings.margin}
    averaged = train(net, loss_terms, settings.schedule, folder, config)
    assert isinstance(averaged, SiameseNet)
    return averaged
