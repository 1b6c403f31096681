"""What an estimator computes with tensors, as ONNX graphs made from the modules that training and estimation use.

``network``: what the network says of clouds. ``energy``: where a state puts keypoints, with derivatives, joints and
parts; in double precision, as the fit needs it. ``hand``: of which hand an object is, as its front says. ONNX's
exporter is an extra (``pip install 'omad[deploy]'``).
"""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from omad.common.errors import InputError
from omad.common.files import write_atomic
from omad.estimation.looks.mirror import Mirror
from omad.geometry.kinematics import joint_lines, part_transforms
from omad.model.fitting.energy import keypoint_jacobian
from omad.model.fitting.state import State
from omad.model.fronts.hands import HandNet
from omad.model.fronts.image import CHANNELS, COLUMNS, ROWS
from omad.model.omadnet import OmadNet
from omad.model.prior import OmadPrior

MOST = 4096
"""Clouds that the network takes at a time."""


class NetworkGraph(nn.Module):
    """``OmadNet`` without what surrounds its tensors. Every second cloud is seen in a mirror where objects are their
    own mirror images, as an estimator shows them."""

    names = ("beta", "T_input_base", "states", "keypoints", "log_sigma", "pooled", "part_logits")

    def __init__(self, net: OmadNet) -> None:
        super().__init__()
        self.net, self.mirror = net, Mirror.of(net.category, net.tells_outside)

    def forward(self, points: Tensor) -> tuple[Tensor, ...]:
        """points (B, N, 3) in the input frame -> ``names``, as ``Prediction`` has them."""
        if self.mirror is None:
            said = self.net(points)
        else:
            images = torch.arange(points.shape[0]) % 2 == 1
            said = self.mirror.back(self.net(self.mirror.images(points, images)), images)
        return tuple(getattr(said, name) for name in self.names)


class EnergyGraph(nn.Module):
    """What the fit asks of a prior, and what becomes of its answer."""

    names = ("points", "jacobian", "canonical", "axes", "pivots", "parts")

    def __init__(self, prior: OmadPrior) -> None:
        super().__init__()
        self.prior = prior

    def forward(self, rows: Tensor) -> tuple[Tensor, ...]:
        """rows (B, 16 + J + D) of ``State.pack`` -> keypoints (B, M, 3) and their derivatives (B, M, 3, P), canonical
        keypoints (B, M, 3), axes and pivots (B, J, 3) and parts (B, J + 1, 4, 4) in the camera frame."""
        state = State.unpack(rows, self.prior.tree.num_joints)
        points, jacobian = keypoint_jacobian(self.prior, state)
        joints, tree = self.prior.joints(state.beta), self.prior.tree
        parts = part_transforms(tree, joints.axes, joints.pivots, state.joint_states, state.T_camera_base)
        lines = joint_lines(tree, joints.axes, joints.pivots, parts)
        return points, jacobian, self.prior.keypoints(state.beta), lines.axes, lines.pivots, parts


class HandGraph(nn.Module):
    """``HandNet`` of one category."""

    names = ("log_odds",)

    def __init__(self, net: HandNet, name: str) -> None:
        super().__init__()
        self.net, self.column = net, net.names.index(name)

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        """images (B, 5, ROWS, COLUMNS) -> (B,)."""
        return (self.net(images)[:, self.column],)


@dataclass(frozen=True)
class Graph:
    """A module that becomes a file."""

    module: nn.Module
    example: Tensor
    """Of what it takes."""
    several: bool
    """Whether its first side may be another."""

    def save(self, path: Path) -> None:
        """Write it, whole or not at all. Raises InputError where the exporter is not installed."""
        try:
            import onnx  # noqa: F401
            import onnxscript  # noqa: F401
        except ImportError as error:
            raise InputError("ONNX's exporter is not installed: pip install 'omad[deploy]'") from error
        names: Any = self.module.names
        sides = {0: torch.export.Dim("several", min=1, max=MOST)} if self.several else {}
        said = logging.getLogger("torch.onnx")
        with warnings.catch_warnings(), _level(said, logging.ERROR):
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                self.module.eval(),
                (self.example,),
                dynamo=True,
                dynamic_shapes=(sides,),
                input_names=["input"],
                output_names=list(names),
                verbose=False,
            )
        assert program is not None
        write_atomic(path, lambda temporary: program.save(str(temporary), external_data=False))


@contextmanager
def _level(logger: logging.Logger, level: int) -> Iterator[None]:
    before, logger.level = logger.level, level
    try:
        yield
    finally:
        logger.level = before


def network_graph(net: OmadNet) -> Graph:
    """Of clouds with as many points as the network's backbone takes."""
    return Graph(NetworkGraph(net), torch.randn(3, net.backbone.config.points, 3), several=True)


def energy_graph(prior: OmadPrior) -> Graph:
    """Of one state, in double precision; ``prior`` is converted."""
    row = torch.cat([torch.eye(4).flatten(), torch.zeros(prior.tree.num_joints), torch.randn(prior.basis_size)])
    return Graph(EnergyGraph(prior.double()), row[None].double(), several=False)


def hand_graph(net: HandNet, name: str) -> Graph:
    """Of one image of a front of the category ``name``."""
    return Graph(HandGraph(net, name), torch.zeros(1, CHANNELS, ROWS, COLUMNS), several=False)
