"""Train a category's prior: OMAD-PriorNet on complete rest-state clouds, then the statistics of beta."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from .categories import Category
from .losses import joint_loss
from .objects import SampledObject
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


def train_prior(
    models: Sequence[SampledObject],
    category: Category,
    folder: Path,
    settings: PriorTraining,
    device: torch.device | str = "cpu",
) -> PriorNet:
    """Learn basis, joint function and statistics of beta from ``models``; returns the averaged network."""
    torch.manual_seed(settings.schedule.seed)  # initial weights of the layers; the rest comes from generators
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
    finish_prior(averaged.prior, object_keypoints(averaged, bank), bank, settings.scale)
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
def object_keypoints(net: PriorNet, bank: SurfaceBank) -> Tensor:
    """Nodes (N, M, 3) of every object at its own scale, from all of its samples: what OMADNet learns to find."""
    nodes = [net(points[None], labels[None]).nodes for points, labels in zip(bank.points, bank.labels, strict=True)]
    return torch.cat(nodes)


def finish_prior(
    prior: OmadPrior, nodes: Tensor, bank: SurfaceBank, scale: tuple[float, float], draws: int = 8, steps: int = 1500
) -> None:
    """Once the nodes correspond, make the prior the best that they allow.

    The basis becomes the best linear one of its size (truncated SVD of all nodes, each object stretched at least
    ``draws`` times; half the error of the basis that taught the nodes), scaled so that every beta has mean square
    one; the joint function is fitted to the betas of that basis; mean and covariance of beta are taken.
    """
    draws = max(draws, -(-2 * prior.basis_size // len(nodes)))  # so that one object is enough
    count, device = draws * len(nodes), nodes.device
    generator = torch.Generator().manual_seed(0)
    stretch = uniform(*scale, (count, 3), nodes.cpu(), generator).to(device)
    stretched = nodes.repeat(draws, 1, 1) * stretch[:, None]
    _, singular, directions = torch.linalg.svd(stretched.flatten(1), full_matrices=False)
    size = prior.basis_size
    singular = singular.clamp(min=1e-4 * float(singular[0]))  # a few objects may not fill the basis
    basis = (directions[:size] * singular[:size, None] / count**0.5).T.reshape(-1, 3, size)
    with torch.no_grad():
        prior.learned_basis.copy_(basis[~prior.is_image])
        beta = prior.encode(stretched)
        prior.beta_mean.copy_(beta.mean(0))
        prior.beta_covariance.copy_(beta.T.cov())

    objects = bank.scaled(torch.arange(len(nodes), device=device).repeat(draws), stretch)
    parameters = [*prior.joint_hidden.parameters(), *prior.joint_out.parameters()]
    for parameter in parameters:
        parameter.requires_grad_(True)
    optimizer = torch.optim.Adam(parameters, lr=3e-3)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        chosen = torch.randint(count, (256,), generator=generator).to(device)
        joints = prior.joints(beta[chosen])
        loss = joint_loss(joints.axes, joints.pivots, objects.axes[chosen], objects.pivots[chosen], prior.revolute)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
    prior.requires_grad_(False)
