"""PointNet++'s forward pass, step by step as ``backbones.pointnet2`` has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..backbones.kernels import fill_groups, max_of_groups, nearest, nearest_three
from ..backbones.pointnet2 import PointNet2, SetAbstraction
from . import kernels
from .layers import Buffer, Layer, ResidualLayers


class Neighbours:
    """Buffers for the k nearest of B times n centres."""

    def __init__(self, clouds: int, centres: int, k: int) -> None:
        self.squared = np.empty((clouds, centres, k), np.float32)
        self.index = np.empty(self.squared.shape, np.int32)


@dataclass(frozen=True)
class AbstractionLayers:
    """``pointnet2.SetAbstraction``."""

    points: Layer
    features: Layer | None
    """What the layer before the grouping does with a point's place, and with its features."""
    centres: Layer
    """What it takes from both at the centre, less the bias of the points' layer."""
    group: Layer
    residual: ResidualLayers
    neighbours: int
    radius: float | None

    @classmethod
    def of(cls, module: SetAbstraction) -> AbstractionLayers:
        whole, scale = Layer.of(module.point_layer), module.scale
        points = Layer(whole.weight[:3] / scale, np.zeros_like(whole.bias))
        features = Layer(whole.weight[3:].contiguous(), whole.bias) if len(whole.weight) > 3 else None
        centres = Layer(Layer.of(module.centre_layer).weight / scale, -whole.bias)
        group, residual = Layer.of(module.group_layer), ResidualLayers.of(module.residual)
        return cls(points, features, centres, group, residual, module.neighbours, module.radius)


class AbstractionWork:
    """Buffers for it: of N points, n of them centres."""

    def __init__(self, layers: AbstractionLayers, clouds: int, points: int, centres: int) -> None:
        width, k = len(layers.group.bias), layers.neighbours
        self.near = Neighbours(clouds, centres, k)
        self.values, self.centres = Buffer(clouds, points, width), Buffer(clouds, centres, width)
        # of one cloud at a time, so that they stay in the processor's cache
        self.grouped, self.layered = Buffer(1, centres * k, width), Buffer(1, centres * k, width)
        self.features = Buffer(clouds, centres, width)
        self.which = np.empty((1, centres, width), np.uint8)


class BackboneWork:
    """Buffers of a pass over B clouds; ``dense`` and ``pooled`` are its answer."""

    def __init__(self, layers: BackboneLayers, clouds: int) -> None:
        config = layers.config
        (n1, n2), (_, second, pooled), dense = config.centres, config.widths, config.dense
        self.first = AbstractionWork(layers.first, clouds, config.points, n1)
        self.second = AbstractionWork(layers.second, clouds, n1, n2)
        self.near = Neighbours(clouds, n1, 3)
        self.before, self.after = Buffer(clouds, n2, pooled), Buffer(clouds, n2, pooled)
        self.which = np.empty((clouds, 1, pooled), np.uint8)
        self.pooled, self.spread = Buffer(clouds, 1, pooled), Buffer(clouds, second)
        self.fused, self.coarse = Buffer(clouds, n2, second), Buffer(clouds, n2, dense)
        self.dense = Buffer(clouds, n1, dense)
        self.room = torch.empty(
            3 * max(b.tensor.numel() for b in (self.first.features, self.fused, self.dense, self.pooled)),
            dtype=torch.float32,
        )


class BackboneLayers:
    """``pointnet2.PointNet2``."""

    def __init__(self, net: PointNet2) -> None:
        self.config = net.config
        self.first, self.second = AbstractionLayers.of(net.abstraction1), AbstractionLayers.of(net.abstraction2)
        self.before, self.after = Layer.of(net.global_layers[0]), Layer.of(net.global_layers[2])
        self.spread, self.fine2 = Layer.of(net.fuse2.coarse_layer), Layer.of(net.fuse2.fine_layer)
        self.coarse, self.fine1 = Layer.of(net.fuse1.coarse_layer), Layer.of(net.fuse1.fine_layer)
        self.residuals = [
            ResidualLayers.of(module)
            for module in (net.global_residual, net.fuse2.residual, net.fuse1.residual, net.dense_residual)
        ]

    def __call__(self, points: np.ndarray, work: BackboneWork) -> None:
        """points (B, N, 3) float32, contiguous."""
        global_residual, residual2, residual1, dense_residual = self.residuals
        features1 = self._abstract(self.first, points, None, work.first, work.room)
        features2 = self._abstract(self.second, points, features1, work.second, work.room)

        split = len(self.before.weight) - 3
        torch.mm(features2.rows, self.before.weight[:split], out=work.before.rows)
        kernels.add_embedded(points, self.before.array[split:], work.before.array)
        kernels.add_relu(self.before.bias, work.before.row_array)
        torch.mm(work.before.rows, self.after.weight, out=work.after.rows)
        max_of_groups(work.after.array, self.after.bias, work.pooled.array, work.which)
        global_residual(work.pooled, work.room)

        torch.mm(work.pooled.rows, self.spread.weight, out=work.spread.tensor)
        torch.mm(features2.rows, self.fine2.weight, out=work.fused.rows)
        kernels.add_each_relu(work.spread.array, self.spread.bias, work.fused.array)
        residual2(work.fused, work.room)

        near = work.near
        nearest_three(points, points, self.config.centres[1], near.squared, near.index)
        torch.mm(work.fused.rows, self.coarse.weight, out=work.coarse.rows)
        torch.mm(features1.rows, self.fine1.weight, out=work.dense.rows)
        kernels.add_blended_relu(work.coarse.array, near.index, near.squared, self.coarse.bias, work.dense.array)
        residual1(work.dense, work.room)
        dense_residual(work.dense, work.room)

    @staticmethod
    def _abstract(
        layers: AbstractionLayers,
        points: np.ndarray,
        features: Buffer | None,
        work: AbstractionWork,
        room: torch.Tensor,
    ) -> Buffer:
        near = work.near
        nearest(points, points, work.values.array.shape[1], near.squared, near.index)
        if layers.radius is not None:
            own = np.arange(near.index.shape[1], dtype=np.int32)[:, None]
            near.index[:] = np.where(near.squared < layers.radius**2, near.index, own)
        if features is None or layers.features is None:
            kernels.embed(points, layers.points.array, layers.points.bias, work.values.array)
        else:
            torch.mm(features.rows, layers.features.weight, out=work.values.rows)
            kernels.add_embedded(points, layers.points.array, work.values.array)
        kernels.embed(points, layers.centres.array, layers.centres.bias, work.centres.array)
        for b in range(len(points)):
            one = slice(b, b + 1)
            fill_groups(work.values.array[one], work.centres.array[one], near.index[one], work.grouped.array)
            torch.mm(work.grouped.rows, layers.group.weight, out=work.layered.rows)
            max_of_groups(work.layered.array, layers.group.bias, work.features.array[one], work.which)
        layers.residual(work.features, room)
        return work.features
