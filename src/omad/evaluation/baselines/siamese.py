"""The Siamese baseline of retrieval: a PointNet++ with contrastive loss (Hadsell, Chopra and LeCun 2006).

It is trained on pairs of the views that OMADNet is trained on, by the same loop.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from omad.common.batches import batched
from omad.common.runtime import pick_device
from omad.data.rendering.viewpoints import uniform
from omad.data.training_views import draw_views_of
from omad.model.backbones import SLIM, BackboneConfig, backbone_from_dict, backbone_to_dict
from omad.model.checkpoint import Network, load
from omad.model.network_input import first_frame, sample_clouds, to_input_frame
from omad.model.omadnet import OmadNet
from omad.objects.category import Category
from omad.objects.model import SampledObject
from omad.sensing.observation import Observation
from omad.training.loop import seeded_bank, train_network
from omad.training.processes import ALONE, Processes
from omad.training.train_net import ViewTraining

EMBEDDING = 32
"""Numbers that a view is known by."""
MARGIN = 1.0
"""Distance beyond which views of different objects are left alone."""
BATCH = 128
"""Observations that are embedded together."""
SAMPLES = 4
"""Random choices of a cloud's points that its embedding is averaged over, as many as the estimator looks at."""


class SiameseNet(Network):
    """OMADNet's backbone, and one vector from its global feature."""

    kind = "siamese"

    def __init__(self, category: Category, backbone: BackboneConfig = SLIM, size: int = EMBEDDING) -> None:
        super().__init__()
        self.category, self.size = category, size
        self.backbone, width = backbone.build(), backbone.pooled
        self.head = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, size))

    def sizes(self) -> dict[str, Any]:
        return {"backbone": backbone_to_dict(self.backbone.config), "size": self.size}

    @classmethod
    def from_sizes(cls, category: Category, sizes: dict[str, Any]) -> Self:
        return cls(category, backbone_from_dict(sizes["backbone"]), sizes["size"])

    def forward(self, points: Tensor) -> Tensor:
        """points (B, N, 3) in the input frame (``omad.model.omadnet``), category units, in any order -> (B, size)."""
        return self.head(self.backbone(points).pooled)


def contrastive_losses(embeddings: Tensor, objects: Tensor, margin: float = MARGIN) -> dict[str, Tensor]:
    """Both terms of the contrastive loss over all pairs of a batch: (B, E) embeddings of ``objects`` (B,). ``same``
    draws views of one object together, ``other`` pushes those of two apart as far as the margin; each is the mean over
    its pairs, so that the few of the one kind count like the many of the other."""
    first, second = torch.triu_indices(len(objects), len(objects), offset=1, device=objects.device)
    squared = (embeddings[first] - embeddings[second]).square().sum(-1)
    alike = objects[first] == objects[second]
    short = (margin - squared.add(1e-12).sqrt()).clamp(min=0).square()
    return {
        "same": (squared * alike).sum() / alike.sum().clamp(min=1),
        "other": (short * ~alike).sum() / (~alike).sum().clamp(min=1),
    }


@dataclass(frozen=True)
class SiameseTraining(ViewTraining):
    """Settings of the Siamese network's training."""

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
    processes: Processes = ALONE,
) -> SiameseNet:
    """Train on views of ``models``, its backbone from that of ``initial`` where given; returns the averaged
    network. ``folder`` as ``omad.training.train``."""
    bank = seeded_bank(models, category, settings.schedule.seed, device)
    net = SiameseNet(category, settings.backbone).to(device)
    if initial is not None:
        net.backbone.load_state_dict(initial.backbone.state_dict())
    like, batch, each = bank.points, processes.share(settings.schedule.batch), settings.views_of_object
    drawn = -(-batch // each)

    def loss_terms(module: SiameseNet, draw: torch.Generator) -> dict[str, Tensor]:
        with torch.no_grad():
            chosen = torch.randint(len(bank), (drawn,), device=like.device, generator=draw)
            scale = uniform(*settings.views.scale, (drawn, 3), like, draw)
            # an object drawn twice is stretched twice: another object
            objects = torch.arange(drawn, device=like.device).repeat_interleave(each)[:batch]
            views = draw_views_of(bank, category, chosen[objects], scale[objects], settings.views, draw)
            points = to_input_frame(views.points, first_frame(views.points))
        return contrastive_losses(module(points), objects, settings.margin)

    return train_network(net, loss_terms, settings, models, folder, bank, [initial], processes=processes)


class SiameseEncoder:
    """Embeds observations."""

    def __init__(self, net: SiameseNet, device: torch.device | str = "cpu") -> None:
        self.net = net.to(device).eval()

    @classmethod
    def from_folder(cls, folder: Path, device: str = "auto") -> Self:
        """From a checkpoint folder. Raises InputError."""
        return cls(load(SiameseNet, folder), pick_device(device))

    def __call__(self, observations: Sequence[Observation]) -> np.ndarray:
        """(B, E) float64."""
        return np.concatenate([first_looks(self.net, some, self.net) for some in batched(observations, BATCH)])


@torch.no_grad()
def first_looks(
    net: SiameseNet | OmadNet, observations: Sequence[Observation], say: Callable[[Tensor], Tensor]
) -> np.ndarray:
    """(B, C) float64: what ``say`` says of clouds in the frame of a first look, the mean over ``SAMPLES`` of each."""
    device = next(net.parameters()).device
    clouds, _ = sample_clouds(observations, net.backbone.config.points, SAMPLES, 0, net.category, device)
    points = clouds.flatten(0, 1)
    said = say(to_input_frame(points, first_frame(points)))
    return said.unflatten(0, (len(observations), -1)).mean(1).cpu().double().numpy()
