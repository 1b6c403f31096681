"""Train a category's prior: OMAD-PriorNet on complete rest-state clouds (paper, section 3.3), then the statistics of
beta."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from omad.common.arrays import as_doubles
from omad.data.rendering.viewpoints import uniform
from omad.data.surface_bank import Joints, PartSamples, SurfaceBank
from omad.geometry.transforms import point_to_line
from omad.model.object_prior import object_keypoints
from omad.model.prior import OmadPrior
from omad.model.priornet import PriorNet, part_boxes
from omad.objects.category import Category
from omad.objects.model import SampledObject

from .held_back import split
from .loop import Schedule, Training, seeded_bank, train_network
from .losses import coverage_loss, joint_loss, part_chamfer, separation_loss, surface_loss
from .processes import ALONE, Processes

FOLLOWED = 512
"""Clouds by which a prior to fine-tune is told its own basis."""
LOOSE = 2
"""Loose numbers of beta, where any joint turns: across one axis there are no more directions, and the hinges of one
object are off alike."""
STRETCHES = 8
"""Times that each object is stretched, of which basis and joint function are made."""
JOINT_STEPS = 1500
"""Of the joint function, once the basis is there."""


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
    net: PriorNet, clouds: Sequence[Tensor], axes: Tensor, pivots: Tensor, weights: PriorLossWeights
) -> dict[str, Tensor]:
    """Every term of the loss, weighted; their sum is the loss. ``clouds`` as in PriorNet.forward; joints (B, J, 3)."""
    out, prior = net(clouds), net.prior
    parts, keypoints, joints = prior.keypoints_of_part, prior.keypoints(out.beta), prior.joints(out.beta)
    low, high = part_boxes(clouds)
    terms = {
        "chamfer": part_chamfer(out.nodes, keypoints, parts),
        "order": (out.nodes - keypoints).norm(dim=-1).mean(),
        "coverage": coverage_loss(out.nodes, parts, low, high),
        "surface": surface_loss(out.nodes, parts, clouds),
        "separation": separation_loss(out.nodes, net.part_of, low, high, weights.separation_share),
        "joint": joint_loss(joints.axes, joints.pivots, axes, pivots, prior.turning),
        "beta": out.beta.square().mean(),
    }
    return {name: getattr(weights, name) * term for name, term in terms.items()}


@dataclass(frozen=True)
class PriorTraining(Training):
    """Settings of a prior's training."""

    schedule: Schedule = Schedule(steps=3000, batch=16, learning_rate=3e-3)
    points: int = 256
    """Points of a complete cloud, as many of each part."""
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
    processes: Processes = ALONE,
) -> PriorNet:
    """Learn basis, joint function and statistics of beta from ``models``, from ``initial`` weights where given, whose
    keypoints then keep their meaning; returns the averaged network. A few objects are held back, if there are many, to
    tell how it goes."""
    seen, held = split(models)
    bank = seeded_bank(seen, category, settings.schedule.seed, device)
    held_back = SurfaceBank.from_models(held, category, seed=1).to(device) if held else None
    net = PriorNet(category, generator=torch.Generator().manual_seed(settings.schedule.seed)).to(device)
    samples, share = PartSamples.of(bank, len(category.parts)), processes.share(settings.schedule.batch)

    def drawn(count: int, draw: torch.Generator) -> tuple[list[Tensor], Joints]:
        indices = torch.randint(len(bank), (count,), device=bank.points.device, generator=draw)
        scale = uniform(*settings.scale, (len(indices), 3), bank.points, draw)
        clouds = samples.draw(indices, scale, settings.points // len(category.parts), draw)
        return clouds, bank.joints(indices, scale)

    if initial is not None:
        net.load_state_dict(initial.state_dict())
        _follow_basis(net, drawn(FOLLOWED, torch.Generator(bank.points.device).manual_seed(0))[0])

    def loss_terms(module: PriorNet, draw: torch.Generator) -> dict[str, Tensor]:
        clouds, joints = drawn(share, draw)
        return prior_losses(module, clouds, joints.axes, joints.pivots, settings.weights)

    def check(module: PriorNet) -> dict[str, float]:
        return {} if held_back is None else prior_error(module, held_back)

    averaged = train_network(net, loss_terms, settings, models, folder, bank, [initial], check, processes)
    finish_prior(averaged.prior, object_keypoints(averaged, bank), bank, settings.scale)
    return averaged


@torch.no_grad()
def _follow_basis(net: PriorNet, clouds: Sequence[Tensor]) -> None:
    """Have the shape branch say the betas of the nodes of ``clouds``, as nearly as an affine map of what it says does:
    it has learned those of another basis, which ``finish_prior`` took away."""
    out, (weight, bias) = net(clouds), net.shape_head[-1].parameters()
    shapes = out.beta[:, : net.prior.shape_size], net.prior.encode(out.nodes)[:, : net.prior.shape_size]
    said, wanted = map(as_doubles, shapes)
    found = np.linalg.lstsq(np.pad(said, ((0, 0), (0, 1)), constant_values=1.0), wanted, rcond=1e-6)[0]
    turn, shift = (torch.as_tensor(each).to(weight) for each in (found[:-1].T, found[-1]))
    weight.copy_(turn @ weight)
    bias.copy_(turn @ bias + shift)


@torch.no_grad()
def prior_error(net: PriorNet, bank: SurfaceBank) -> dict[str, float]:
    """How far from where they are found the basis puts keypoints of the objects in ``bank``, and how far from the true
    axes pivots are; means, category units."""
    nodes = object_keypoints(net, bank)
    prior, beta = net.prior, net.prior.encode(nodes)
    found = {"held back, keypoints": float((prior.keypoints(beta) - nodes).norm(dim=-1).mean())}
    if prior.turning.any():
        off = point_to_line(prior.joints(beta).pivots, bank.axes, bank.pivots)[:, prior.turning]
        found["held back, pivots"] = float(off.mean())
    return found


def stretched_objects(
    nodes: Tensor, bank: SurfaceBank, scale: tuple[float, float], draws: int = STRETCHES
) -> tuple[Tensor, Joints]:
    """The objects of a bank, whose ``nodes`` (N, M, 3) are, each stretched ``draws`` times along the canonical axes:
    nodes (N draws, M, 3) and joints. Always the same."""
    count, device = draws * len(nodes), nodes.device
    stretch = uniform(*scale, (count, 3), nodes.cpu(), torch.Generator().manual_seed(0)).to(device)
    joints = bank.joints(torch.arange(len(nodes), device=device).repeat(draws), stretch)
    return nodes.repeat(draws, 1, 1) * stretch[:, None], joints


def finish_prior(prior: OmadPrior, nodes: Tensor, bank: SurfaceBank, scale: tuple[float, float]) -> None:
    """Once the nodes correspond, make the prior the best that they allow.

    The basis becomes the best linear one of its size (truncated SVD of all nodes, each object stretched at least
    ``STRETCHES`` times; half the error of the basis that taught the nodes), scaled so that every beta has mean square
    one; the joint function is fitted to the betas of that basis; mean and covariance of beta are taken; how the true
    pivots lie off that function becomes what the loose numbers of beta move.
    """
    size, device, generator = prior.shape_size, nodes.device, torch.Generator().manual_seed(1)
    draws = max(STRETCHES, -(-2 * size // len(nodes)))  # so that one object is enough
    stretched, objects = stretched_objects(nodes, bank, scale, draws)
    count = len(stretched)
    _, singular, directions = torch.linalg.svd(stretched.flatten(1), full_matrices=False)
    singular = singular.clamp(min=1e-4 * float(singular[0]))  # a few objects may not fill the basis
    basis = (directions[:size] * singular[:size, None] / count**0.5).T.reshape(-1, 3, size)
    with torch.no_grad():
        prior.loosen(prior.pivot_basis[..., :0])
        prior.learned_basis.copy_(basis[~prior.is_image])
        beta = prior.encode(stretched)
        prior.beta_mean.copy_(beta.mean(0))
        prior.beta_covariance.copy_(beta.T.cov())

    layers = nn.ModuleList([prior.joint_hidden, prior.joint_out]).requires_grad_(True)
    optimizer = torch.optim.Adam(layers.parameters(), lr=3e-3)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, JOINT_STEPS)
    for _ in range(JOINT_STEPS):
        chosen = torch.randint(count, (256,), generator=generator).to(device)
        joints = prior.joints(beta[chosen])
        loss = joint_loss(joints.axes, joints.pivots, objects.axes[chosen], objects.pivots[chosen], prior.turning)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
    prior.requires_grad_(False)
    loosen_pivots(prior, beta, objects)


@torch.no_grad()
def loosen_pivots(prior: OmadPrior, beta: Tensor, joints: Joints) -> None:
    """Let beta end in what the true ``joints`` of N objects tell of their pivots and their shapes ``beta`` (N, D) do
    not: the largest principal components of how far the axes lie off the joint function's pivots."""
    found = prior.joints(beta)
    off = (joints.pivots - found.pivots) * prior.turning[:, None]
    off = off - (off * found.axes).sum(-1, keepdim=True) * found.axes
    _, singular, directions = torch.linalg.svd(off.flatten(1), full_matrices=False)
    count = LOOSE if prior.turning.any() else 0
    spread = directions[:count] * singular[:count, None] / len(off) ** 0.5
    prior.loosen(spread.T.reshape(*prior.pivot_basis.shape[:2], count))
