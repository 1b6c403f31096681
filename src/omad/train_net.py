"""Train OMADNet on endless views, with the labels that a trained PriorNet gives its objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from .categories import Category
from .errors import InputError
from .geometry import invert_transform, make_transform, matrix_to_quaternion, quarter_turns, so3_exp
from .keypoint_jacobian import State
from .kinematics import deform, joint_lines, part_transforms
from .losses import confidence_loss, joint_loss, quaternion_loss, state_loss
from .objects import SampledObject
from .omadnet import OmadNet, first_frame, to_input_frame
from .pointnet2 import SLIM, BackboneConfig
from .prior import JointParameters
from .priornet import PriorNet
from .refinement import RefinementConfig, beta_whitening
from .refinement_loss import axis_distance, refined_error, refinement_loss
from .train_prior import object_keypoints
from .training import Schedule, train
from .views import SurfaceBank, ViewBatch, ViewSettings, draw_views


@dataclass(frozen=True)
class NetLossWeights:
    """The paper's weights, and two of our own: ``confidence`` teaches each keypoint's expected error, ``refinement``
    to place keypoints so that the refined answer is right (``refinement_loss``). That one is for fine-tuning, 6 is a
    good weight: from nothing, it only disturbs the learning of keypoints."""

    keypoints: float = 5.0
    segmentation: float = 1.0
    base: float = 0.2
    states: float = 5.0
    shape: float = 3.0
    joints: float = 3.0
    beta: float = 0.01
    confidence: float = 0.1
    refinement: float = 0.0


@dataclass(frozen=True)
class NetTraining:
    """Settings of the network's training besides the schedule."""

    schedule: Schedule = Schedule(steps=20000, batch=64, learning_rate=2e-3)
    backbone: BackboneConfig = SLIM
    views: ViewSettings = ViewSettings()
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
    prior = net.prior
    beta = prior.encode(nodes[views.indices] * views.scale[:, None])
    canonical = prior.keypoints(beta)
    keypoints = deform(
        prior.tree, prior.part_of, canonical, views.axes, views.pivots, views.states, views.T_camera_base
    )
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
    turns = torch.cat([quarter_turns(), torch.eye(4)[None]]).to(like)
    error = turns[turn] @ error
    second = torch.rand(batch, 1, 1, dtype=like.dtype, device=like.device, generator=generator) < share
    return torch.where(second, views.T_camera_base @ error, first_frame(views.points))


def net_losses(
    net: OmadNet, views: ViewBatch, truth: ViewTruth, frames: Tensor, whitening: Tensor, weights: NetLossWeights
):
    """Every weighted term of the loss; their sum is the loss. ``frames``: T_camera_input (B, 4, 4)."""
    prior = net.prior
    out = net(to_input_frame(views.points, frames))
    T_input_base = invert_transform(frames) @ views.T_camera_base
    distance = (out.keypoints - to_input_frame(truth.keypoints, frames)).square().sum(-1).add(1e-12).sqrt()
    predicted: JointParameters = prior.joints(out.beta)
    rotation = quaternion_loss(out.quaternion, matrix_to_quaternion(T_input_base[:, :3, :3]))
    translation = (out.translation - T_input_base[:, :3, 3]).norm(dim=-1).mean()
    terms = {
        "keypoints": weights.keypoints * distance.mean(),
        "confidence": weights.confidence * confidence_loss(distance, out.log_sigma),
        "segmentation": weights.segmentation
        * torch.nn.functional.cross_entropy(out.part_logits.flatten(0, 1), views.labels.flatten()),
        "base": weights.base * (rotation + 0.5 * translation),
        "states": weights.states * state_loss(out.states, views.states, prior.revolute),
        "shape": weights.shape * (prior.keypoints(out.beta) - truth.canonical).norm(dim=-1).mean(),
        "joints": weights.joints
        * joint_loss(predicted.axes, predicted.pivots, views.axes, views.pivots, prior.revolute),
        "beta": weights.beta * out.beta.square().mean(),
    }
    if weights.refinement > 0:
        at_truth = State(truth.beta, views.states, T_input_base)
        precision = (-2 * out.log_sigma.detach()).exp()
        error = refined_error(prior, out.keypoints, precision, at_truth, whitening)
        G = part_transforms(prior.tree, views.axes, views.pivots, views.states, T_input_base)
        distance = axis_distance(prior, at_truth, error, joint_lines(prior.tree, views.axes, views.pivots, G))
        terms["refinement"] = weights.refinement * refinement_loss(error, distance)
    return terms


def train_net(
    models: Sequence[SampledObject],
    category: Category,
    priornet: PriorNet,
    folder: Path,
    settings: NetTraining,
    device: torch.device | str = "cpu",
    initial: OmadNet | None = None,
    features: OmadNet | None = None,
) -> OmadNet:
    """Train OMADNet on views of ``models``, from ``initial`` weights where given, or with the backbone alone from
    ``features``, whose prior may be another; returns the averaged network."""
    torch.manual_seed(settings.schedule.seed)  # initial weights
    bank = SurfaceBank.from_models(models, category, seed=settings.schedule.seed).to(device)
    priornet = priornet.to(device).requires_grad_(False)
    nodes = object_keypoints(priornet, bank)
    net = OmadNet(category, priornet.prior, settings.backbone, settings.attention).to(device)
    if initial is not None:
        _start_from(net, initial)
    if features is not None:
        net.backbone.load_state_dict(features.backbone.state_dict())

    whitening = beta_whitening(priornet.prior.beta_covariance, RefinementConfig().prior_weight)

    def loss_terms(module: torch.nn.Module, draw: torch.Generator) -> dict[str, Tensor]:
        assert isinstance(module, OmadNet)
        with torch.no_grad():
            views = draw_views(bank, category, settings.schedule.batch, settings.views, draw)
            truth = view_truth(module, views, nodes)
            frames = disturbed_frames(views, settings.second_looks, settings.turned, draw)
        return net_losses(module, views, truth, frames, whitening, settings.weights)

    config = {"kind": "net", "category": asdict(category), "objects": [m.name for m in models]}
    config |= {"backbone": asdict(settings.backbone), "views": asdict(settings.views)}
    config |= {"weights": asdict(settings.weights), "attention": settings.attention}
    averaged = train(net, loss_terms, settings.schedule, folder, config)
    assert isinstance(averaged, OmadNet)
    return averaged


def _start_from(net: OmadNet, initial: OmadNet) -> None:
    """Copy the weights of ``initial``. Raises InputError where its prior is another one: it would answer in another
    language."""
    if initial.prior.basis.shape != net.prior.basis.shape or not torch.allclose(
        initial.prior.basis.to(net.prior.basis), net.prior.basis, atol=1e-5
    ):
        raise InputError(
            "the network to fine-tune belongs to another prior; give --prior the prior it was trained with"
        )
    net.load_state_dict(initial.state_dict())
