"""Weights laid out for a forward pass, and the buffers that it runs in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from ..backbones.pointnet2 import Residual
from . import kernels


class Buffer:
    """The same memory as a tensor, for matrix products, and as an array, for compiled loops."""

    def __init__(self, *shape: int) -> None:
        self.tensor = torch.empty(shape, dtype=torch.float32)
        self.array = self.tensor.numpy()
        self.rows = self.tensor.flatten(0, -2)
        self.row_array = self.rows.numpy()


@dataclass(frozen=True)
class Layer:
    """A linear layer."""

    weight: Tensor
    """(inputs, outputs)."""
    bias: np.ndarray
    """(outputs,)."""

    @classmethod
    def of(cls, layer: nn.Module) -> Layer:
        """Of an ``nn.Linear``. Copies: a network that is sent to another process leaves the memory that it was in."""
        assert isinstance(layer, nn.Linear)
        bias = layer.weight.new_zeros(layer.out_features) if layer.bias is None else layer.bias.detach()
        return cls(layer.weight.detach().T.clone(memory_format=torch.contiguous_format), bias.numpy().copy())

    @property
    def array(self) -> np.ndarray:
        """The weight."""
        return self.weight.numpy()


@dataclass(frozen=True)
class ResidualLayers:
    """``pointnet2.Residual`` with the scale and shift of its normalisation in the layer that follows."""

    wide: Layer
    narrow: Layer

    @classmethod
    def of(cls, module: Residual) -> ResidualLayers:
        norm, wide = module.layers[0], Layer.of(module.layers[1])
        assert isinstance(norm, nn.LayerNorm)
        scale, shift = norm.weight.detach(), norm.bias.detach()
        bias = wide.bias + (shift @ wide.weight).numpy()
        return cls(Layer(scale[:, None] * wide.weight, bias), Layer.of(module.layers[3]))

    def __call__(self, x: Buffer, room: Tensor) -> None:
        """In place of ``x``, rows of C; ``room`` has three times its size."""
        n, width = x.rows.shape
        normed = room[: n * width].view(n, width)
        hidden = room[n * width : 3 * n * width].view(n, 2 * width)
        kernels.normalise(x.row_array, self.narrow.bias, normed.numpy())
        torch.mm(normed, self.wide.weight, out=hidden)
        kernels.add_relu(self.wide.bias, hidden.numpy())
        x.rows.addmm_(hidden, self.narrow.weight)
