"""Train OMADNet on endless views, with the labels that a trained PriorNet gives its objects."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from omad.common.errors import InputError
from omad.data.training_views import ViewBatch, ViewSettings, draw_views
from omad.geometry.kinematics import deform, joint_lines, part_transforms
from omad.geometry.transforms import (
    MIRROR_X,
    invert_transform,
    make_transform,
    matrix_to_quaternion,
    quarter_turns,
    so3_exp,
)
from omad.model.backbones import SLIM, BackboneConfig
from omad.model.fitting.energy import RefinementConfig, ShapePrior
from omad.model.fitting.state import State
from omad.model.network_input import first_frame, to_input_frame
from omad.model.object_prior import object_keypoints
from omad.model.omadnet import OmadNet
from omad.model.prior import OmadPrior
from omad.model.priornet import PriorNet
from omad.objects.category import Category
from omad.objects.model import SampledObject

from .held_back import HeldBack, split
from .loop import Schedule, Training, seeded_bank, train_network
from .losses import confidence_loss, hand_loss, joint_loss, quaternion_loss, segmentation_loss, state_loss
from .processes import ALONE, Processes
from .refined_error import axis_distance, refined_error, refinement_loss

SAME_KEYPOINTS = 0.1
"""Two priors are of the same keypoints where one can put the other's mean shape so near to where it is, on average, in
category units; others are half an object away, as the order of keypoints is left to chance."""


@dataclass(frozen=True)
class NetLossWeights:
    """The paper's weights, and three of our own: ``confidence`` teaches each keypoint's expected error, ``hand`` to
    tell a cloud from its mirror image, ``refinement`` to place keypoints so that the refined answer is right
    (``refinement_loss``). That one is for fine-tuning, 6 is a good weight: from nothing, it only disturbs the learning
    of keypoints."""

    keypoints: float = 5.0
    segmentation: float = 1.0
    base: float = 0.2
    states: float = 5.0
    shape: float = 3.0
    joints: float = 3.0
    beta: float = 0.01
    confidence: float = 0.1
    refinement: float = 0.0
    hand: float = 0.5
    """Only of categories whose objects may be of either hand."""
    outside: float = 3.0
    """How many times a point that is not on the object counts in ``segmentation``: one that is dropped in vain does
    little harm, one that stays does much."""


@dataclass(frozen=True)
class ViewTraining(Training):
    """Settings of any training on views; the baselines have the same budget, backbone and views as OMADNet."""

    schedule: Schedule = Schedule(steps=20000, batch=64, learning_rate=2e-3)
    backbone: BackboneConfig = SLIM
    views: ViewSettings = ViewSettings()


@dataclass(frozen=True)
class NetTraining(ViewTraining):
    """Settings of OMADNet's training."""

    weights: NetLossWeights = NetLossWeights()
    second_looks: float = 0.5
    """Share of views shown in a disturbed base frame, as the second look at an object is."""
    turned: float = 0.15
    """Share of those that are turned by quarters too, as after a first answer that took one side for another."""
    attention: bool = True
    """Whether votes for keypoints have scores."""


@dataclass(frozen=True)
class ViewTruth:
    """What a batch of views should be answered with, in camera space and category units."""

    beta: Tensor
    """(B, |beta|)."""
    keypoints: Tensor
    """(B, M, 3)."""
    canonical: Tensor
    """(B, M, 3) keypoints of beta in canonical space."""


def view_truth(net: OmadNet, views: ViewBatch, nodes: Tensor) -> ViewTruth:
    """Labels of views of objects whose own keypoints are ``nodes`` (N, M, 3): stretched with the view's object,
    expressed in beta, and carried by the true joints."""
    prior, joints = net.prior, (views.axes, views.pivots, views.states)
    beta = prior.encode(nodes[views.indices] * views.scale[:, None])
    canonical = prior.keypoints(beta)
    keypoints = deform(prior.tree, prior.part_of, canonical, *joints, views.T_camera_base)
    return ViewTruth(beta=beta, keypoints=keypoints, canonical=canonical)


def disturbed_frames(views: ViewBatch, share: float, turned: float, generator: torch.Generator) -> Tensor:
    """T_camera_input (B, 4, 4): the first look's frame, or for a ``share`` of views the base frame with an error
    such as a first answer has: mostly a few degrees, sometimes tens, and for a share ``turned`` of those a quarter,
    half or three-quarter turn about a canonical axis besides."""
    batch, like = len(views.points), views.points

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, dtype=like.dtype, device=like.device, generator=generator)

    size = 0.12 * (1 + normal(batch, 1).square())
    error = make_transform(so3_exp(normal(batch, 3) * size), 0.25 * size * normal(batch, 3))
    turn = torch.randint(9, (batch,), device=like.device, generator=generator)
    turn = torch.where(torch.rand(batch, device=like.device, generator=generator) < turned, turn, 9)
    error = torch.cat([quarter_turns(), torch.eye(4)[None]]).to(like)[turn] @ error
    second = torch.rand(batch, 1, 1, dtype=like.dtype, device=like.device, generator=generator) < share
    return torch.where(second, views.T_camera_base @ error, first_frame(views.points))


def net_losses(
    net: OmadNet, views: ViewBatch, truth: ViewTruth, frames: Tensor, shape_prior: ShapePrior, weights: NetLossWeights
) -> dict[str, Tensor]:
    """Every weighted term of the loss; their sum is the loss. ``frames``: T_camera_input (B, 4, 4)."""
    points = to_input_frame(views.points, frames)
    prior, out = net.prior, net(points)
    T_input_base = invert_transform(frames) @ views.T_camera_base
    distance = (out.keypoints - to_input_frame(truth.keypoints, frames)).square().sum(-1).add(1e-12).sqrt()
    joints = prior.joints(out.beta)
    rotation = quaternion_loss(out.quaternion, matrix_to_quaternion(T_input_base[:, :3, :3]))
    translation = (out.translation - T_input_base[:, :3, 3]).norm(dim=-1).mean()
    terms = {
        "keypoints": distance.mean(),
        "confidence": confidence_loss(distance, out.log_sigma),
        "segmentation": segmentation_loss(out.part_logits, views.labels, len(net.category.parts), weights.outside),
        "base": rotation + 0.5 * translation,
        "states": state_loss(out.states, views.states, prior.turning),
        "shape": (prior.keypoints(out.beta) - truth.canonical).norm(dim=-1).mean(),
        "joints": joint_loss(joints.axes, joints.pivots, views.axes, views.pivots, prior.turning),
        "beta": out.beta.square().mean(),
    }
    if net.category.either_hand:
        terms["hand"] = hand_loss(out.pooled, net.backbone.pooled(points * points.new_tensor(MIRROR_X)))
    if weights.refinement > 0:
        at_truth = State(truth.beta, views.states, T_input_base)
        precision = (-2 * out.log_sigma.detach()).exp()
        error = refined_error(prior, out.keypoints, precision, at_truth, shape_prior)
        G = part_transforms(prior.tree, views.axes, views.pivots, views.states, T_input_base)
        distance = axis_distance(prior, at_truth, error, joint_lines(prior.tree, views.axes, views.pivots, G))
        terms["refinement"] = refinement_loss(error, distance)
    return {name: getattr(weights, name) * term for name, term in terms.items()}


def train_net(
    models: Sequence[SampledObject],
    category: Category,
    priornet: PriorNet,
    folder: Path,
    settings: NetTraining,
    device: torch.device | str = "cpu",
    initial: OmadNet | None = None,
    features: OmadNet | None = None,
    processes: Processes = ALONE,
) -> OmadNet:
    """Train OMADNet on views of ``models``, from ``initial`` weights where given, or with what ``features`` knows of
    clouds, whose prior and category may be others; returns the averaged network. A few of the objects are held back, if
    there are many: they tell how it goes, and what share of its own joint states shall be in answers; without them that
    stays as ``initial`` has it. Raises InputError where the prior of ``initial`` has other keypoints: it would answer
    in another language."""
    seen, held = split(models)
    bank = seeded_bank(seen, category, settings.schedule.seed, device)
    held_back = HeldBack.of(held, category, settings.views, device) if held else None
    made_of, share = [priornet, initial, features], processes.share(settings.schedule.batch)
    priornet = priornet.to(device).requires_grad_(False)
    nodes = object_keypoints(priornet, bank)
    tells_outside = settings.views.clutter is not None or (initial is not None and initial.tells_outside)
    net = OmadNet(category, priornet.prior, settings.backbone, settings.attention, tells_outside).to(device)
    prior = priornet.prior
    if initial is not None:
        initial = initial.to(device)
        check_same_keypoints(prior, initial.prior)
        net.start_from(initial)
    if features is not None:
        net.learn_from(features.to(device))
    shape_prior = ShapePrior.of(prior.beta_mean, prior.beta_covariance, RefinementConfig().prior_weight)

    def loss_terms(module: OmadNet, draw: torch.Generator) -> dict[str, Tensor]:
        with torch.no_grad():
            views = draw_views(bank, category, share, settings.views, draw)
            truth = view_truth(module, views, nodes)
            frames = disturbed_frames(views, settings.second_looks, settings.turned, draw)
        return net_losses(module, views, truth, frames, shape_prior, settings.weights)

    check = None if held_back is None else held_back.errors
    averaged = train_network(net, loss_terms, settings, models, folder, bank, made_of, check, processes)
    if held_back is not None:
        averaged.own_states = held_back.best_share(averaged.eval())
    elif initial is not None:
        averaged.own_states = initial.own_states
    return averaged


def check_same_keypoints(prior: OmadPrior, other: OmadPrior) -> None:
    """Raises InputError where a prior is not the other one, nor was fine-tuned from it."""
    if prior.learned_basis.shape == other.learned_basis.shape:
        theirs = other.keypoints(other.beta_mean[None]).to(prior.basis)
        apart = (prior.keypoints(prior.encode(theirs)) - theirs).norm(dim=-1).mean()
        if apart < SAME_KEYPOINTS:
            return
    raise InputError(
        "the network to fine-tune belongs to another prior; give --prior the prior it was trained with, or one that was"
        " fine-tuned from that"
    )
