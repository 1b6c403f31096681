"""OMADNet on the CPU: the same answers as ``omadnet.OmadNet`` gives, to rounding, in half the time."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from ..backbones.kernels import nearest_three
from ..backbones.pointnet2 import PointNet2
from ..omadnet import OmadNet, Prediction
from . import kernels
from .backbone import BackboneLayers, BackboneWork, Neighbours
from .layers import Buffer, Layer

TOGETHER = 4
"""Clouds of a pass. More take no less time each, and leave the processor's cache."""


class Work(BackboneWork):
    """Buffers of a pass over B clouds."""

    def __init__(self, layers: BackboneLayers, heads: InferenceNet, clouds: int) -> None:
        super().__init__(layers, clouds)
        n, N = layers.config.centres[0], layers.config.points
        self.hidden, self.votes = Buffer(clouds, n, layers.config.dense), Buffer(clouds, n, len(heads.votes.bias))
        self.part_coarse, self.part = (Buffer(clouds, count, len(heads.part_coarse.bias)) for count in (n, N))
        self.part_near = Neighbours(clouds, N, 3)


def inference_net(net: OmadNet) -> OmadNet | InferenceNet:
    """What answers fastest where ``net`` is: itself, unless it is a PointNet++ on the CPU."""
    on_cpu = net.part_out.weight.device.type == "cpu"
    return InferenceNet(net) if on_cpu and isinstance(net.backbone, PointNet2) else net


class InferenceNet:
    """A network laid out for the CPU; its weights do not change any more. Several threads may call it at once: there
    are buffers for as many calls as ever were at work together, however many threads there are."""

    def __init__(self, net: OmadNet) -> None:
        assert isinstance(net.backbone, PointNet2)
        self.net, self.backbone = net, BackboneLayers(net.backbone)
        self.before_votes, self.votes = Layer.of(net.keypoint_branch[0]), Layer.of(net.keypoint_branch[2])
        self.part_coarse, self.part_out = Layer.of(net.part_coarse), Layer.of(net.part_out)
        fine = Layer.of(net.part_fine)
        self.part_fine = Layer(fine.weight / 0.2, fine.bias)
        self.idle = [deque[Work]() for _ in range(TOGETHER)]

    def __reduce__(self) -> tuple[type[InferenceNet], tuple[OmadNet]]:
        """A pickle holds the network once, and no buffers."""
        return type(self), (self.net,)

    @torch.no_grad()
    def __call__(self, points: Tensor, labels: bool = True) -> Prediction:
        """points (B, N, 3) float32, as ``OmadNet`` takes them; without ``labels`` the ``part_logits`` are of none."""
        clouds, (batch, count) = points.contiguous().numpy(), points.shape[:2]
        pooled = points.new_empty(batch, self.backbone.config.pooled)
        keypoints = points.new_empty(batch, self.net.category.num_keypoints, 3)
        log_sigma = points.new_empty(keypoints.shape[:2])
        logits = points.new_empty(batch, count if labels else 0, len(self.part_out.bias))
        for first in range(0, batch, TOGETHER):
            some = slice(first, min(first + TOGETHER, batch))
            with self._work(some.stop - first) as work:
                self.backbone(clouds[some], work)
                pooled[some] = work.pooled.rows
                self._vote(clouds[some], work, keypoints[some].numpy(), log_sigma[some].numpy())
                if labels:
                    self._label(clouds[some], work, logits[some])
        return self.net.prediction(pooled, keypoints, log_sigma, logits)

    def _vote(self, points: np.ndarray, work: Work, keypoints: np.ndarray, log_sigma: np.ndarray) -> None:
        torch.mm(work.dense.rows, self.before_votes.weight, out=work.hidden.rows)
        kernels.add_relu(self.before_votes.bias, work.hidden.row_array)
        torch.mm(work.hidden.rows, self.votes.weight, out=work.votes.rows)
        kernels.cast_votes(points, work.votes.array, self.votes.bias, self.net.attention, keypoints, log_sigma)

    def _label(self, points: np.ndarray, work: Work, logits: Tensor) -> None:
        near, coarse = work.part_near, self.part_coarse
        nearest_three(points, points, work.dense.array.shape[1], near.squared, near.index)
        torch.mm(work.dense.rows, coarse.weight, out=work.part_coarse.rows)
        kernels.embed(points, self.part_fine.array, self.part_fine.bias, work.part.array)
        kernels.add_blended_relu(work.part_coarse.array, near.index, near.squared, coarse.bias, work.part.array)
        torch.addmm(self.net.part_out.bias, work.part.rows, self.part_out.weight, out=logits.flatten(0, 1))

    @contextmanager
    def _work(self, clouds: int) -> Iterator[Work]:
        idle = self.idle[clouds - 1]
        try:
            work = idle.pop()
        except IndexError:
            work = Work(self.backbone, self, clouds)
        try:
            yield work
        finally:
            idle.append(work)
