"""Train A-NCSH on the same endless views as OMADNet, in the same input frames, by the same loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from ..categories import Category
from ..objects import SampledObject
from ..omadnet import OmadNet, to_input_frame
from ..pointnet2 import SLIM, BackboneConfig
from ..train_net import NetTraining, disturbed_frames
from ..training import Schedule, train
from ..views import SurfaceBank, ViewSettings, draw_views
from .coordinates import part_boxes, true_coordinates
from .losses import AncshLossWeights, ancsh_losses
from .net import AncshNet

_OMADNET = NetTraining()


@dataclass(frozen=True)
class AncshTraining:
    """Settings of A-NCSH's training; all but the losses are OMADNet's."""

    schedule: Schedule = _OMADNET.schedule
    backbone: BackboneConfig = SLIM
    views: ViewSettings = _OMADNET.views
    weights: AncshLossWeights = AncshLossWeights()
    second_looks: float = _OMADNET.second_looks
    turned: float = _OMADNET.turned


def train_ancsh(
    models: Sequence[SampledObject],
    category: Category,
    folder: Path,
    settings: AncshTraining,
    device: torch.device | str = "cpu",
    initial: OmadNet | None = None,
) -> AncshNet:
    """Train A-NCSH on views of ``models``, its backbone from that of ``initial`` where given; returns the averaged
    network. ``folder`` as ``omad.training.train``."""
    torch.manual_seed(settings.schedule.seed)  # initial weights
    bank = SurfaceBank.from_models(models, category, seed=settings.schedule.seed).to(device)
    boxes = part_boxes(bank, len(category.parts))
    net = AncshNet(category, settings.backbone).to(device)
    if initial is not None:
        net.backbone.load_state_dict(initial.backbone.state_dict())

    def loss_terms(module: torch.nn.Module, draw: torch.Generator) -> dict[str, Tensor]:
        assert isinstance(module, AncshNet)
        with torch.no_grad():
            views = draw_views(bank, category, settings.schedule.batch, settings.views, draw)
            truth = true_coordinates(views, boxes, category)
            frames = disturbed_frames(views, settings.second_looks, settings.turned, draw)
        return ancsh_losses(module(to_input_frame(views.points, frames)), truth, category, settings.weights)

    config = {"kind": "ancsh", "category": asdict(category), "objects": [m.name for m in models]}
    config |= {"backbone": asdict(settings.backbone), "views": asdict(settings.views)}
    averaged = train(net, loss_terms, settings.schedule, folder, config)
    assert isinstance(averaged, AncshNet)
    return averaged
