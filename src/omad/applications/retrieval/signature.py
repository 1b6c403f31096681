"""What an object is known by, whatever its pose: beta, how sure it is, and the prior whose language it speaks."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
import torch

from omad.common.arrays import as_doubles, numbers
from omad.common.errors import InputError
from omad.data.surface_bank import SurfaceBank
from omad.estimation.estimate import Estimate
from omad.model.object_prior import object_keypoints
from omad.model.prior import OmadPrior
from omad.model.priornet import PriorNet
from omad.objects.category import Category
from omad.objects.model import SampledObject

Metric = Literal["keypoints", "beta", "whitened"]


@dataclass(frozen=True)
class Signature:
    """Shape parameters of one object."""

    prior: str
    """Fingerprint of the prior that gives beta its meaning."""
    beta: np.ndarray
    """(D,)."""
    covariance: np.ndarray | None = None
    """(D, D) of beta; None where it is not known."""


@dataclass(frozen=True)
class Space:
    """Where signatures of one prior are compared: Euclidean distance between ``factor @ beta``."""

    prior: str
    """Fingerprint."""
    category: str
    metric: Metric
    factor: np.ndarray
    """(D, D) float64."""

    @classmethod
    def of(cls, prior: OmadPrior, category: Category, metric: Metric = "keypoints") -> Self:
        """``keypoints``: RMS distance in metres between canonical keypoints; ``beta``: that of plain beta, as in the
        paper; ``whitened``: in standard deviations of beta over the prior's training objects."""
        size = prior.basis_size
        if metric == "keypoints":
            basis = prior.basis.detach().double().reshape(-1, size).numpy()
            # |B d| = |R d|, with R of B = QR: as many numbers as beta has, instead of three a keypoint
            factor = np.linalg.qr(basis).R * category.metres_per_unit / np.sqrt(category.num_keypoints)
        elif metric == "whitened":
            factor = np.linalg.inv(np.linalg.cholesky(prior.beta_covariance.double().numpy()))
        else:
            factor = np.eye(size)
        return cls(prior_fingerprint(prior, category), category.name, metric, factor)

    def check(self, signature: Signature) -> None:
        """Raises InputError where the signature speaks another prior's language."""
        if signature.prior != self.prior:
            both = f"the signature is of prior {signature.prior}, the index of prior {self.prior} ({self.category})"
            cure = "use the weights that made the index, or build it anew"
            raise InputError(f"{both}: their betas do not compare; {cure}")
        size = len(self.factor)
        numbers(signature.beta, size, what="beta")
        if signature.covariance is not None:
            numbers(signature.covariance, size, size, what="covariance of beta")


def prior_fingerprint(prior: OmadPrior, category: Category) -> str:
    """Tells one prior from another: 16 hexadecimal digits of the category's parts and unit, and of the basis."""
    parts = [(part.name, part.keypoints, part.mirror) for part in category.parts]
    digest = hashlib.sha256(repr((category.name, category.metres_per_unit, parts)).encode())
    digest.update(np.ascontiguousarray(prior.learned_basis.detach().cpu().numpy(), dtype="<f4").tobytes())
    return digest.hexdigest()[:16]


def estimate_signature(estimate: Estimate, prior: str) -> Signature:
    """Of an observed object; ``prior`` is the fingerprint of the estimator's."""
    covariance = estimate.covariance[-len(estimate.beta) :, -len(estimate.beta) :]
    return Signature(prior, estimate.beta, covariance if np.isfinite(covariance).all() else None)


@torch.no_grad()
def model_signatures(net: PriorNet, models: Sequence[SampledObject]) -> list[Signature]:
    """Of object models: PriorNet's keypoints on their surface, in the language of the basis. No view is needed."""
    prior = prior_fingerprint(net.prior, net.category)
    bank = SurfaceBank.from_models(models, net.category).to(net.prior.basis.device)
    return [Signature(prior, beta) for beta in as_doubles(net.prior.encode(object_keypoints(net, bank)))]


def information_factor(query: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """(D, D): Euclidean distance between ``factor @ beta`` counts in standard deviations of the difference between a
    query, of covariance ``query`` (D, D), and the gallery's entries, whose covariance is usually ``usual`` (D, D)."""
    try:
        return np.linalg.inv(np.linalg.cholesky(query + usual))
    except np.linalg.LinAlgError as error:
        raise InputError("the covariances are none; leave out the weighting by information") from error


def fuse(signatures: Sequence[Signature]) -> Signature:
    """One object's signature from several views of it: the mean, each weighted by its information (inverse covariance)
    where all have one. Raises InputError for none, and for signatures of several priors."""
    if not signatures:
        raise InputError("no view to take a signature from; give at least one")
    if len({signature.prior for signature in signatures}) > 1:
        raise InputError("the views' signatures are of several priors; estimate all with the same weights")
    betas = np.stack([signature.beta for signature in signatures])
    covariances = [signature.covariance for signature in signatures if signature.covariance is not None]
    if len(covariances) < len(signatures):
        return Signature(signatures[0].prior, betas.mean(0))
    information = np.linalg.inv(np.stack(covariances))
    covariance = np.linalg.inv(information.sum(0))
    beta = covariance @ np.einsum("vij,vj->i", information, betas)
    return Signature(signatures[0].prior, beta, covariance)
