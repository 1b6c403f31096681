"""Train a category's prior: OMAD-PriorNet on complete rest-state clouds (paper, section 3.3), then the statistics of
beta."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from omad.data.rendering.viewpoints import uniform
from omad.data.surface_bank import SurfaceBank
from omad.model.object_prior import object_keypoints
from omad.model.prior import OmadPrior
from omad.model.priornet import PriorNet, part_extents
from omad.objects.category import Category
from omad.objects.model import SampledObject

from .loop import Schedule, Training, seeded_bank, train_network
from .losses import coverage_loss, joint_loss, part_chamfer, separation_loss, surface_loss


@dataclass(frozen=True)
class PriorLossWeights:
    """The paper's weights. Our own: ``order`` ties the i-th node to the i-th keypoint, and a wider separation."""

    chamfer: float = 1.0
    coverage: float = 1.0
    surface: float = 5.0
    separation: float = 2.0
    joint: float = 1.0
    beta: float = 0.01
    order: float = 1.0
    separation_share: float = 1 / 5
    """Smallest distance between keypoints of a part, as a share of its box diagonal (paper: 1/8)."""


def prior_losses(
    net: PriorNet, points: Tensor, labels: Tensor, axes: Tensor, pivots: Tensor, weights: PriorLossWeights
) -> dict[str, Tensor]:
    """Every term of the loss, weighted; their sum is the loss. Shapes as in PriorNet.forward; joints (B, J, 3)."""
    out, prior, part_of = net(points, labels), net.prior, net.part_of
    keypoints, joints = prior.keypoints(out.beta), prior.joints(out.beta)
    parts = torch.arange(len(net.category.parts), device=labels.device)
    low, high = part_extents(points, labels[:, None] == parts[:, None])
    terms = {
        "chamfer": part_chamfer(out.nodes, keypoints, part_of),
        "order": (out.nodes - keypoints).norm(dim=-1).mean(),
        "coverage": coverage_loss(out.nodes, part_of, low, high),
        "surface": surface_loss(out.nodes, part_of, points, labels),
        "separation": separation_loss(out.nodes, part_of, low, high, weights.separation_share),
        "joint": joint_loss(joints.axes, joints.pivots, axes, pivots, prior.turning),
        "beta": out.beta.square().mean(),
    }
    return {name: getattr(weights, name) * term for name, term in terms.items()}


@dataclass(frozen=True)
class PriorTraining(Training):
    """Settings of a prior's training."""

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
    initial: PriorNet | None = None,
) -> PriorNet:
    """Learn basis, joint function and statistics of beta from ``models``, from ``initial`` weights where given, whose
    keypoints then keep their meaning; returns the averaged network."""
    bank = seeded_bank(models, category, settings.schedule.seed, device)
    net = PriorNet(category, generator=torch.Generator().manual_seed(settings.schedule.seed)).to(device)
    if initial is not None:
        net.load_state_dict(initial.state_dict())

    def loss_terms(module: PriorNet, draw: torch.Generator) -> dict[str, Tensor]:
        objects, points, labels = _draw(bank, settings, draw)
        return prior_losses(module, points, labels, objects.axes, objects.pivots, settings.weights)

    averaged = train_network(net, loss_terms, settings, models, folder, bank, [initial])
    finish_prior(averaged.prior, object_keypoints(averaged, bank), bank, settings.scale)
    return averaged


def _draw(bank: SurfaceBank, settings: PriorTraining, generator: torch.Generator) -> tuple[SurfaceBank, Tensor, Tensor]:
    """Random stretched objects, and a random part of their samples: points (B, n, 3), labels (B, n)."""
    batch, device = settings.schedule.batch, bank.points.device
    indices = torch.randint(len(bank), (batch,), device=device, generator=generator)
    objects = bank.scaled(indices, uniform(*settings.scale, (batch, 3), bank.points, generator))
    chosen = torch.randint(bank.points.shape[1], (batch, settings.points), device=device, generator=generator)
    points = objects.points.gather(1, chosen[..., None].expand(-1, -1, 3))
    return objects, points, objects.labels.gather(1, chosen)


def finish_prior(
    prior: OmadPrior, nodes: Tensor, bank: SurfaceBank, scale: tuple[float, float], draws: int = 8, steps: int = 1500
) -> None:
    """Once the nodes correspond, make the prior the best that they allow.

    The basis becomes the best linear one of its size (truncated SVD of all nodes, each object stretched at least
    ``draws`` times; half the error of the basis that taught the nodes), scaled so that every beta has mean square
    one; the joint function is fitted to the betas of that basis; mean and covariance of beta are taken.
    """
    draws = max(draws, -(-2 * prior.basis_size // len(nodes)))  # so that one object is enough
    count, size, device = draws * len(nodes), prior.basis_size, nodes.device
    generator = torch.Generator().manual_seed(0)
    stretch = uniform(*scale, (count, 3), nodes.cpu(), generator).to(device)
    stretched = nodes.repeat(draws, 1, 1) * stretch[:, None]
    _, singular, directions = torch.linalg.svd(stretched.flatten(1), full_matrices=False)
    singular = singular.clamp(min=1e-4 * float(singular[0]))  # a few objects may not fill the basis
    basis = (directions[:size] * singular[:size, None] / count**0.5).T.reshape(-1, 3, size)
    with torch.no_grad():
        prior.learned_basis.copy_(basis[~prior.is_image])
        beta = prior.encode(stretched)
        prior.beta_mean.copy_(beta.mean(0))
        prior.beta_covariance.copy_(beta.T.cov())

    objects = bank.scaled(torch.arange(len(nodes), device=device).repeat(draws), stretch)
    layers = nn.ModuleList([prior.joint_hidden, prior.joint_out]).requires_grad_(True)
    optimizer = torch.optim.Adam(layers.parameters(), lr=3e-3)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        chosen = torch.randint(count, (256,), generator=generator).to(device)
        joints = prior.joints(beta[chosen])
        loss = joint_loss(joints.axes, joints.pivots, objects.axes[chosen], objects.pivots[chosen], prior.turning)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
    prior.requires_grad_(False)
