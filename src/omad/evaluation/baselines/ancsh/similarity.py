"""The similarity that brings a part's NPCS onto the cloud: Umeyama's closed form inside RANSAC.

Parts, hypotheses and images are all batch dimensions. B images, K parts, P points of each, H hypotheses.
"""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Similarity:
    """``p -> scale * rotation @ p + translation``."""

    scale: Tensor
    """(...)."""
    rotation: Tensor
    """(..., 3, 3)."""
    translation: Tensor
    """(..., 3)."""

    def apply(self, points: Tensor) -> Tensor:
        """(..., N, 3) -> (..., N, 3)."""
        return self.scale[..., None, None] * points @ self.rotation.mT + self.translation[..., None, :]


@dataclass(frozen=True)
class RansacConfig:
    """How a part is aligned."""

    hypotheses: int = 128
    """Of three points each."""
    points: int = 512
    """At most so many points of a part are looked at."""
    threshold: float = 0.1
    """An inlier's largest error, as a share of the part's diagonal: no similarity can win by shrinking the part."""
    fits: int = 3
    """Times that the best hypothesis is fitted to its inliers anew."""


def fit_similarity(a: Tensor, b: Tensor, weights: Tensor) -> Similarity:
    """The similarity that brings ``a`` (..., N, 3) nearest to ``b``: weighted least squares, closed form. Umeyama,
    "Least-squares estimation of transformation parameters between two point patterns", 1991. ``weights`` (..., N);
    where they or the points of ``a`` tell nothing, the scale is 0."""
    share = (weights / weights.sum(-1, keepdim=True).clamp(min=1e-12))[..., None]
    mean_a, mean_b = (share * a).sum(-2), (share * b).sum(-2)
    a, b = a - mean_a[..., None, :], b - mean_b[..., None, :]
    U, S, V = torch.linalg.svd((share * b).mT @ a)
    sign = torch.ones_like(S)
    sign[..., 2] = torch.where(torch.linalg.det(U) * torch.linalg.det(V) < 0, -1.0, 1.0)
    R = U * sign[..., None, :] @ V
    scale = (S * sign).sum(-1) / (share * a.square()).sum((-1, -2)).clamp(min=1e-12)
    return Similarity(scale, R, mean_b - scale[..., None] * (R @ mean_a[..., None]).squeeze(-1))


def ransac(
    npcs: Tensor, camera: Tensor, count: Tensor, config: RansacConfig, generator: torch.Generator
) -> tuple[Similarity, Tensor]:
    """Align the first ``count`` (B, K) of the points ``npcs`` (B, K, P, 3) of each part with ``camera`` (B, K, P, 3):
    the best similarity (B, K), and which points are its inliers (B, K, P) bool.

    The lowest sum of squared errors, each at most the threshold's, wins. Every image is given the same random numbers,
    so that its answer does not depend on the others of its batch.
    """
    B, K, P = npcs.shape[:3]
    limit, member = config.threshold**2, torch.arange(P, device=npcs.device) < count[..., None]
    drawn = torch.rand(K, config.hypotheses, 3, generator=generator).to(npcs)
    triples = (drawn * count[..., None, None]).long().clamp(max=P - 1)  # (B, K, H, 3)
    index = triples.flatten(2)[..., None].expand(-1, -1, -1, 3)
    a, b = (points.gather(2, index).unflatten(2, (-1, 3)) for points in (npcs, camera))
    hypotheses = fit_similarity(a, b, torch.ones_like(a[..., 0]))
    errors = _errors(hypotheses, npcs[:, :, None], camera[:, :, None]).clamp(max=limit)
    best = (errors * member[:, :, None]).sum(-1).argmin(-1)
    rows, columns = torch.arange(B, device=best.device)[:, None], torch.arange(K, device=best.device)
    found = Similarity(*(values[rows, columns, best] for values in vars(hypotheses).values()))
    for _ in range(config.fits):
        found = fit_similarity(npcs, camera, (member & (_errors(found, npcs, camera) < limit)).to(npcs))
    return found, member & (_errors(found, npcs, camera) < limit)


def _errors(similarity: Similarity, npcs: Tensor, camera: Tensor) -> Tensor:
    """Squared errors (..., P) in units of the part's diagonal."""
    squared = (similarity.apply(npcs) - camera).square().sum(-1)
    return squared / similarity.scale.square().clamp(min=1e-12)[..., None]
