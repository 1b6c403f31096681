"""Train A-NCSH on the same endless views as OMADNet, in the same input frames, by the same loop.

Losses: cross-entropy for parts, distances for coordinates and joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from omad.data.training_views import draw_views
from omad.model.network_input import to_input_frame
from omad.model.omadnet import OmadNet
from omad.objects.category import Category
from omad.objects.model import SampledObject
from omad.training.loop import seeded_bank, train_network
from omad.training.processes import ALONE, Processes
from omad.training.train_net import NetTraining, ViewTraining, disturbed_frames

from .coordinates import Coordinates, linked, of_own_part, part_boxes, pick, true_coordinates
from .net import AncshNet, AncshPrediction


@dataclass(frozen=True)
class AncshLossWeights:
    """The authors' weights: coordinates ten times the rest."""

    segmentation: float = 1.0
    npcs: float = 10.0
    naocs: float = 10.0
    heat: float = 1.0
    towards: float = 1.0
    axes: float = 1.0


@dataclass(frozen=True)
class AncshTraining(ViewTraining):
    """Settings of A-NCSH's training; all but the losses are OMADNet's."""

    weights: AncshLossWeights = AncshLossWeights()
    second_looks: float = NetTraining.second_looks
    turned: float = NetTraining.turned


def train_ancsh(
    models: Sequence[SampledObject],
    category: Category,
    folder: Path,
    settings: AncshTraining,
    device: torch.device | str = "cpu",
    initial: OmadNet | None = None,
    processes: Processes = ALONE,
) -> AncshNet:
    """Train A-NCSH on views of ``models``, its backbone from that of ``initial`` where given; returns the averaged
    network. ``folder`` as ``omad.training.train``."""
    bank, share = (
        seeded_bank(models, category, settings.schedule.seed, device),
        processes.share(settings.schedule.batch),
    )
    boxes = part_boxes(bank, len(category.parts))
    net = AncshNet(category, settings.backbone).to(device)
    if initial is not None:
        net.backbone.load_state_dict(initial.backbone.state_dict())

    def loss_terms(module: AncshNet, draw: torch.Generator) -> dict[str, Tensor]:
        with torch.no_grad():
            views = draw_views(bank, category, share, settings.views, draw)
            truth = true_coordinates(views, boxes, category)
            frames = disturbed_frames(views, settings.second_looks, settings.turned, draw)
        return ancsh_losses(module(to_input_frame(views.points, frames)), truth, category, settings.weights)

    return train_network(net, loss_terms, settings, models, folder, bank, [initial], processes=processes)


def ancsh_losses(
    out: AncshPrediction, truth: Coordinates, category: Category, weights: AncshLossWeights
) -> dict[str, Tensor]:
    """Every weighted term of the loss; their sum is the loss. Coordinates count for a point's true part. A joint's axis
    is asked of the two parts that it links, the way to it of points near it."""
    labels, near = truth.labels, truth.heat > 0
    turning = torch.tensor(category.turning, device=labels.device)
    npcs, sizes, centres = (of_own_part(values, labels) for values in (out.npcs, out.sizes[..., None], out.centres))
    naocs = (sizes * npcs + centres - truth.naocs).norm(dim=-1)
    # a point's size and centre could make up for each other; so they are asked for, too
    size = (sizes.squeeze(-1) - pick(truth.sizes, labels)).abs()
    centre = (centres - pick(truth.centres, labels)).norm(dim=-1)
    segmentation = torch.nn.functional.cross_entropy(out.part_logits.flatten(0, 1), labels.flatten())
    return {
        "segmentation": weights.segmentation * segmentation,
        "npcs": weights.npcs * (npcs - truth.npcs).norm(dim=-1).mean(),
        "naocs": weights.naocs * (naocs.mean() + size.mean() + centre.mean()) / 3,
        "heat": weights.heat * _mean((out.heat - truth.heat).abs(), turning.expand_as(near)),
        "towards": weights.towards * _mean((out.towards - truth.towards).norm(dim=-1), near),
        "axes": weights.axes * _mean((out.axes - truth.axes[:, None]).norm(dim=-1), linked(labels, category)),
    }


def _mean(values: Tensor, where: Tensor) -> Tensor:
    return (values * where).sum() / where.sum().clamp(min=1)
