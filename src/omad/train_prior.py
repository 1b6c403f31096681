"""Train a category's prior: OMAD-PriorNet on complete rest-state clouds, then the statistics of beta."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from .categories import Category
from .objects import ObjectModel
from .prior import OmadPrior
from .priornet import PriorLossWeights, PriorNet, prior_losses
from .training import Schedule, train
from .viewpoints import uniform
from .views import SurfaceBank


@dataclass(frozen=True)
class PriorTraining:
    """Settings of a prior's training besides the schedule."""

    schedule: Schedule = Schedule(steps=6000, batch=32, learning_rate=2e-3)
    points: int = 512
    """Points of a complete cloud."""
    scale: tuple[float, float] = (0.8, 1.2)
    """Range of the random stretch of each canonical axis; joints are carried along."""
    weights: PriorLossWeights = PriorLossWeights()


@dataclass(frozen=True)
class ObjectKeypoints:
    """What a trained PriorNet says of a bank's objects, in category units: the labels that OMADNet learns from."""

    nodes: Tensor
    """(N, M, 3) keypoints of each object at its own scale, canonical space at rest."""


def train_prior(
    models: Sequence[ObjectModel],
    category: Category,
    folder: Path,
    settings: PriorTraining,
    device: torch.device | str = "cpu",
) -> PriorNet:
    """Learn basis, joint function and statistics of beta from ``models``; returns the averaged network."""
    generator = torch.Generator().manual_seed(settings.schedule.seed)
    bank = SurfaceBank.from_models(models, category, seed=settings.schedule.seed).to(device)
    net = PriorNet(category, generator=generator).to(device)

    def loss_terms(module: torch.nn.Module, draw: torch.Generator) -> dict[str, Tensor]:
        assert isinstance(module, PriorNet)
        objects, points, labels = _draw(bank, settings, draw)
        return prior_losses(module, points, labels, objects.axes, objects.pivots, settings.weights)

    config = {"kind": "prior", "category": asdict(category), "objects": [m.name for m in models]}
    averaged = train(net, loss_terms, settings.schedule, folder, config)
    assert isinstance(averaged, PriorNet)
    set_statistics(averaged.prior, object_keypoints(averaged, bank).nodes, settings.scale, generator)
    return averaged


def _draw(bank: SurfaceBank, settings: PriorTraining, generator: torch.Generator) -> tuple[SurfaceBank, Tensor, Tensor]:
    """Random stretched objects, and a random part of their samples: points (B, n, 3), labels (B, n)."""
    batch, device = settings.schedule.batch, bank.points.device
    indices = torch.randint(len(bank), (batch,), device=device, generator=generator)
    scale = uniform(*settings.scale, (batch, 3), bank.points, generator)
    objects = bank.scaled(indices, scale)
    chosen = torch.randint(bank.points.shape[1], (batch, settings.points), device=device, generator=generator)
    points = objects.points.gather(1, chosen[..., None].expand(-1, -1, 3))
    return objects, points, objects.labels.gather(1, chosen)


@torch.no_grad()
def object_keypoints(net: PriorNet, bank: SurfaceBank) -> ObjectKeypoints:
    """Nodes of every object from all of its samples."""
    nodes = [net(points[None], labels[None]).nodes for points, labels in zip(bank.points, bank.labels, strict=True)]
    return ObjectKeypoints(nodes=torch.cat(nodes))


@torch.no_grad()
def set_statistics(
    prior: OmadPrior, nodes: Tensor, scale: tuple[float, float], generator: torch.Generator, draws: int = 8
) -> None:
    """Mean and covariance of beta over the training objects, each stretched ``draws`` times."""
    stretch = uniform(*scale, (draws * len(nodes), 1, 3), nodes.cpu(), generator).to(nodes.device)
    beta = prior.encode(nodes.repeat(draws, 1, 1) * stretch)
    prior.beta_mean.copy_(beta.mean(0))
    prior.beta_covariance.copy_(beta.T.cov())
