"""Training losses, pure functions. B objects, M keypoints, N points, K parts; lengths in category units."""

import math
from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy, smooth_l1_loss, softplus

from omad.geometry.transforms import point_to_line
from omad.model.priornet import part_boxes


def nearest(a: Tensor, b: Tensor) -> Tensor:
    """Distance of each point of ``a`` (B, P, 3) to its nearest point of ``b`` (B, Q, 3) -> (B, P)."""
    with torch.no_grad():  # the search is a matrix product; the distance itself is exact and differentiable
        index = (b.square().sum(-1)[:, None] - 2 * a @ b.mT).argmin(-1)
    partner = b.gather(1, index[..., None].expand(-1, -1, 3))
    return ((a - partner).square().sum(-1) + 1e-12).sqrt()


def part_chamfer(a: Tensor, b: Tensor, parts: Sequence[slice]) -> Tensor:
    """Symmetric chamfer distance between keypoint sets (B, M, 3) of the same ``parts``."""
    there = torch.cat([nearest(a[:, of], b[:, of]) for of in parts], 1)
    back = torch.cat([nearest(b[:, of], a[:, of]) for of in parts], 1)
    return there.mean() + back.mean()


def surface_loss(keypoints: Tensor, parts: Sequence[slice], clouds: Sequence[Tensor]) -> Tensor:
    """Mean distance of keypoints (B, M, 3) of ``parts`` to the cloud (B, n, 3) of their own part, one-sided."""
    return torch.cat([nearest(keypoints[:, of], cloud) for of, cloud in zip(parts, clouds, strict=True)], 1).mean()


def coverage_loss(keypoints: Tensor, parts: Sequence[slice], low: Tensor, high: Tensor) -> Tensor:
    """Keypoints of a part should span its box (``low``, ``high``: (B, K, 3)); plain and relative form averaged."""
    low_k, high_k = part_boxes([keypoints[:, of] for of in parts])
    size = (high - low).clamp(min=0.02)
    size_k = (high_k - low_k).clamp(min=1e-3)
    off = partial(smooth_l1_loss, beta=0.1)
    plain = off(high_k, high) + off(low_k, low)
    relative = off(high_k / size, high / size) + off(low_k / size, low / size) + off(size_k.log(), size.log())
    return (plain + relative) / 2


def separation_loss(keypoints: Tensor, part_of: Tensor, low: Tensor, high: Tensor, share: float = 1 / 8) -> Tensor:
    """Hinge: keypoints of a part closer together than a ``share`` of the part's box diagonal."""
    margin = (share * (high - low).norm(dim=-1))[:, part_of]
    pairs = (part_of[:, None] == part_of[None]) & ~torch.eye(len(part_of), dtype=torch.bool, device=part_of.device)
    squared = (keypoints[:, :, None] - keypoints[:, None]).square().sum(-1)
    gap = (margin[..., None] - (squared + 1e-12).sqrt()).clamp(min=0)  # a finite gradient at zero
    return (gap * pairs).sum((1, 2)).mean() / pairs.sum()


def joint_loss(axes: Tensor, pivots: Tensor, true_axes: Tensor, true_pivots: Tensor, turning: Tensor) -> Tensor:
    """Pivot's distance from the true axis where ``turning`` (J,) + half of 1 - cos between axes, all (B, J, 3)."""
    distance = point_to_line(pivots, true_axes, true_pivots) * turning
    return (distance + 0.5 * (1 - (axes * true_axes).sum(-1))).mean()


def quaternion_loss(q: Tensor, true_q: Tensor) -> Tensor:
    """1 - (q . q*)^2 for unit quaternions (B, 4): blind to the double cover's sign."""
    return (1 - (q * true_q).sum(-1).square()).mean()


def state_loss(states: Tensor, true_states: Tensor, turning: Tensor) -> Tensor:
    """Squared joint-state error (B, J); angles as a share of pi, lengths in category units."""
    error = states - true_states
    return torch.where(turning, error / math.pi, error).square().mean()


def confidence_loss(distance: Tensor, log_sigma: Tensor) -> Tensor:
    """Negative log-likelihood of keypoint distances (B, M) under an isotropic 3-D Gaussian of spread exp(log_sigma).
    The distance is taken as given, so that confidence is learned without loosening the keypoints."""
    return (3 * log_sigma + 0.5 * distance.detach().square() * (-2 * log_sigma).exp()).mean()


def segmentation_loss(logits: Tensor, labels: Tensor, parts: int, outside: float) -> Tensor:
    """Cross-entropy of part logits (B, N, K) and labels (B, N), where points that are not on the object, labelled with
    the number of ``parts``, count ``outside`` times."""
    weight = torch.ones(logits.shape[-1], dtype=logits.dtype, device=logits.device)
    weight[parts:] = outside
    return cross_entropy(logits.flatten(0, 1), labels.flatten(), weight)


def hand_loss(own: Tensor, image: Tensor) -> Tensor:
    """How hard it is to tell clouds from their mirror images, by pooled features (B, width) of both: the negative
    logarithm of the probability of the former, whose log-odds are the sum of every other feature less that of the rest.
    That needs no weights, as the layer before has them."""

    def score(pooled: Tensor) -> Tensor:
        return (pooled[:, ::2].sum(1) - pooled[:, 1::2].sum(1)) / pooled.shape[1] ** 0.5

    return softplus(score(image) - score(own)).mean()
