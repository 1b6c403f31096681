"""Are training views like rendered ones? The same network must make the same error on both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from .objects import ObjectModel
from .observation import Observation
from .omadnet import OmadNet, first_frame, to_input_frame
from .priornet import PriorNet
from .standard_views import standard_views
from .train_net import view_truth
from .train_prior import object_keypoints
from .views import SurfaceBank, ViewBatch, ViewSettings, choose_points, draw_views


@dataclass(frozen=True)
class ViewAgreement:
    """Mean keypoint distance of one network's first look, category units."""

    category: str
    views: int
    """Of each kind."""
    error_on_training_views: float
    error_on_rendered_views: float
    ratio: float
    """Training views over rendered views."""


@torch.no_grad()
def compare_views(
    net: OmadNet, priornet: PriorNet, models: Sequence[ObjectModel], views: int = 1000, seed: int = 0
) -> ViewAgreement:
    """Errors on noise-free training views and on rendered standard views of the same objects."""
    category, points = net.category, net.backbone.config.points
    device = net.prior.revolute.device
    bank = SurfaceBank.from_models(models, category).to(device)
    nodes = object_keypoints(priornet, bank)
    generator = torch.Generator(device).manual_seed(seed)
    settings = ViewSettings(points=points, scale=(1.0, 1.0), noise=0.0)
    batches = [draw_views(bank, category, 50, settings, generator) for _ in range(-(-views // 50))]
    drawn = torch.cat([_errors(net, batch, nodes) for batch in batches])[:views]
    rendered = _rendered(models, bank, net, views, seed)
    seen = torch.cat([_errors(net, batch, nodes) for batch in rendered])
    a, b = float(drawn.mean()), float(seen.mean())
    return ViewAgreement(category.name, views, a, b, a / b)


def _errors(net: OmadNet, views: ViewBatch, nodes: torch.Tensor) -> torch.Tensor:
    """Mean keypoint distance of each view."""
    frames = first_frame(views.points)
    said = net(to_input_frame(views.points, frames)).keypoints
    true = view_truth(net, views, nodes).keypoints
    return (said - to_input_frame(true, frames)).norm(dim=-1).mean(-1)


def _rendered(models: Sequence[ObjectModel], bank: SurfaceBank, net: OmadNet, views: int, seed: int) -> list[ViewBatch]:
    """Standard views as batches such as training has them."""
    rng = np.random.default_rng(seed)
    unit, prismatic, points = (
        net.category.metres_per_unit,
        ~net.prior.revolute.cpu().numpy(),
        net.backbone.config.points,
    )
    index, clouds, states, poses = [], [], [], []
    for number, view in enumerate(standard_views(models, net.category, views, seed)):
        cloud = Observation.from_depth(view.depth, view.camera).points
        clouds.append(cloud[choose_points(cloud, points, rng)] / unit)
        states.append(np.where(prismatic, view.states / unit, view.states))
        poses.append(view.T_camera_base)
        index.append(number % len(models))
    device = bank.points.device
    pose = torch.as_tensor(np.stack(poses), dtype=torch.float32, device=device)
    pose[:, :3, 3] /= unit
    which = torch.tensor(index, device=device)
    batch = ViewBatch(
        points=torch.as_tensor(np.stack(clouds), dtype=torch.float32, device=device),
        labels=torch.zeros(len(index), points, dtype=torch.int64, device=device),
        states=torch.as_tensor(np.stack(states), dtype=torch.float32, device=device),
        T_camera_base=pose,
        axes=bank.axes[which],
        pivots=bank.pivots[which],
        indices=which,
        scale=torch.ones(len(index), 3, device=device),
    )
    return [
        ViewBatch(**{name: getattr(batch, name)[start : start + 50] for name in batch.__dataclass_fields__})
        for start in range(0, len(index), 50)
    ]
