"""Neighbours, groups and interpolation: the steps of PointNet++ that are no matrix product.

On the CPU, float32 tensors go through compiled loops (``kernels``), forward and backward; anything else through the
plain PyTorch beside them, which the tests hold them to. B clouds, N points, n centres, k neighbours, C features.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import linear

from . import kernels


def gather(values: Tensor, index: Tensor) -> Tensor:
    """Rows of ``values`` (B, N, C) at ``index`` (B, ...) -> (B, ..., C)."""
    flat = index.flatten(1)[..., None].long().expand(-1, -1, values.shape[-1])
    return values.gather(1, flat).reshape(*index.shape, values.shape[-1])


@torch.no_grad()
def nearest(queries: Tensor, points: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Squared distances and indices (B, Q, k) of the k nearest ``points`` (B, N, 3) to ``queries`` (B, Q, 3)."""
    if not compiled(queries, points):
        return plain_nearest(queries, points, k)
    squared = queries.new_empty(*queries.shape[:2], k)
    index = torch.empty(squared.shape, dtype=torch.int32)
    search = kernels.nearest_three if k == 3 else kernels.nearest
    search(as_array(queries), as_array(points), points.shape[1], squared.numpy(), index.numpy())
    return squared, index


def plain_nearest(queries: Tensor, points: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """``nearest`` on any device, whatever precision the layers around it have."""
    with torch.autocast(queries.device.type, enabled=False):
        if torch.compiler.is_exporting():  # to the last digit, which a product loses far from the origin
            distance = (queries[:, :, None] - points[:, None]).square().sum(-1)
        else:
            distance = (
                queries.square().sum(-1, keepdim=True) - 2 * queries @ points.mT + points.square().sum(-1)[:, None]
            )
    squared, index = distance.topk(k, largest=False, sorted=False)
    return squared.clamp(min=0), index


def pooled_groups(values: Tensor, centres: Tensor, index: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """The maximum over each centre's group (``index`` (B, n, k)) of a linear layer (``weight`` (D, C), ``bias`` (D,))
    on relu(``values`` (B, N, C) of its members - its own ``centres`` (B, n, C)) -> (B, n, D)."""
    if compiled(values, centres, weight) and index.shape[2] <= 256:  # a byte says which of a group is the largest
        return _PooledGroups.apply(values, centres, index, weight, bias)
    return plain_pooled_groups(values, centres, index, weight, bias)


def plain_pooled_groups(values: Tensor, centres: Tensor, index: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """``pooled_groups`` on any device."""
    return linear((gather(values, index) - centres[:, :, None]).relu(), weight, bias).amax(2)


def interpolate(queries: Tensor, points: Tensor, values: Tensor) -> Tensor:
    """Values (B, n, C) at ``points`` carried to ``queries`` (B, N, 3) by inverse squared distance -> (B, N, C)."""
    squared, index = nearest(queries, points, 3)
    shares = 1 / (squared + 1e-6)
    shares = shares / shares.sum(-1, keepdim=True)
    if compiled(values, shares):
        return _Blend.apply(values, index, shares)
    return (gather(values, index) * shares[..., None]).sum(2)


def compiled(*tensors: Tensor) -> bool:
    """Whether the compiled loops take these tensors. What is exported consists of plain operations."""
    return not torch.compiler.is_exporting() and all(
        tensor.device.type == "cpu" and tensor.dtype == torch.float32 for tensor in tensors
    )


def as_array(tensor: Tensor) -> Any:
    """A NumPy view, C-contiguous; a copy where the tensor is not."""
    return tensor.detach().contiguous().numpy()


class _PooledGroups(torch.autograd.Function):
    """A cloud at a time, so that its groups stay in the processor's cache; they are made again going back."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, centres: Tensor, index: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
        batch, n, k = index.shape
        index = index.int()
        grouped, layered = values.new_empty(1, n * k, values.shape[-1]), values.new_empty(1, n * k, len(weight))
        most = values.new_empty(batch, n, len(weight))
        which = torch.empty(most.shape, dtype=torch.uint8)
        groups, biases, turned = as_array(layered), as_array(bias), weight.detach().T
        inputs, outputs = [as_array(tensor) for tensor in (values, centres, index)], (most.numpy(), which.numpy())
        for b in range(batch):
            value, centre, near = (array[b : b + 1] for array in inputs)
            kernels.fill_groups(value, centre, near, grouped.numpy())
            torch.mm(grouped[0], turned, out=layered[0])
            kernels.max_of_groups(groups, biases, outputs[0][b : b + 1], outputs[1][b : b + 1])
        ctx.save_for_backward(values, centres, index, weight, which)
        return most

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        values, centres, index, weight, which = ctx.saved_tensors
        slopes = [weight.new_zeros(shape) for shape in (values.shape, centres.shape, weight.shape, len(weight))]
        kernels.max_of_groups_backward(*map(as_array, (values, centres, index, weight, which, gradient, *slopes)))
        return slopes[0], slopes[1], None, slopes[2], slopes[3]


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, index: Tensor, shares: Tensor) -> Tensor:
        out = values.new_empty(*shares.shape[:2], values.shape[-1])
        kernels.blend(*map(as_array, (values, index, shares, out)))
        ctx.save_for_backward(index, shares)
        ctx.size = values.shape
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        index, shares = ctx.saved_tensors
        d_values = gradient.new_zeros(ctx.size)
        kernels.blend_backward(*map(as_array, (index, shares, gradient, d_values)))
        return d_values, None, None
