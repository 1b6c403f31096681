"""What an object is known by, whatever its pose: beta, how sure it is, and the prior whose language it speaks."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Self, get_args

import numpy as np
import torch
from scipy.special import expit, logit

from omad.common.arrays import as_doubles, numbers
from omad.common.errors import InputError
from omad.data.surface_bank import SurfaceBank
from omad.estimation.checks import SURE_OF_HAND
from omad.estimation.estimate import Estimate
from omad.estimation.known import information
from omad.model.object_prior import object_keypoints
from omad.model.prior import OmadPrior
from omad.model.priornet import PriorNet
from omad.objects.category import Category
from omad.objects.model import SampledObject

Metric = Literal["keypoints", "beta", "whitened"]
SUREST, UNTOLD = 0.999, 0.6
"""Probability of a hand beyond which none counts for more, and that of one of which nobody learned how to tell it."""
ROUNDED = 1e-9
"""By how much factors of one prior differ at most, as processors round otherwise."""


@dataclass(frozen=True, eq=False)
class Signature:
    """Shape parameters of one object."""

    prior: str
    """Fingerprint of the prior that gives beta its meaning."""
    beta: np.ndarray
    """(D,)."""
    covariance: np.ndarray | None = None
    """(D, D) of beta; None where it is not known."""
    mirrored_probability: float | None = None
    """That the object is the mirror image of what beta says (``Estimate.of_other_hand``); None where its category has
    one hand only, or nothing tells."""

    @property
    def of_other_hand(self) -> bool | None:
        """Whether it is, where that is told surely."""
        probability = self.mirrored_probability
        sure = probability is not None and max(probability, 1 - probability) >= SURE_OF_HAND
        return bool(probability > 0.5) if sure and probability is not None else None

    def in_mirror(self) -> Self:
        """That of the mirror image of the object."""
        probability = self.mirrored_probability
        return self if probability is None else replace(self, mirrored_probability=1 - probability)


@dataclass(frozen=True, eq=False)
class Space:
    """Where signatures of one prior are compared: Euclidean distance between ``factor @ beta``."""

    prior: str
    """Fingerprint."""
    category: str
    """Its name."""
    metric: Metric
    """Which distance that is (``of``)."""
    factor: np.ndarray
    """(D, D) float64."""

    @classmethod
    def of(cls, prior: OmadPrior, category: Category, metric: Metric = "keypoints") -> Self:
        """``keypoints``: RMS distance in metres between canonical keypoints; ``beta``: that of plain beta, as in the
        paper; ``whitened``: in standard deviations of beta over the prior's training objects. Raises InputError for
        another metric."""
        if metric not in get_args(Metric):
            raise InputError(f"metric {metric!r}: no such metric; choose of {', '.join(get_args(Metric))}")
        size = prior.basis_size
        if metric == "keypoints":
            basis = as_doubles(prior.basis).reshape(-1, size)
            # |B d| = |R d|, with R of B = QR: as many numbers as beta has, instead of three a keypoint
            factor = np.linalg.qr(basis).R * category.metres_per_unit / np.sqrt(category.num_keypoints)
        elif metric == "whitened":
            factor = np.linalg.inv(np.linalg.cholesky(as_doubles(prior.beta_covariance)))
        else:
            factor = np.eye(size)
        return cls(prior_fingerprint(prior, category), category.name, metric, factor)

    def vectors(self, betas: np.ndarray) -> np.ndarray:
        """(N, D) float32 of betas (N, D): their Euclidean distances are those of the space."""
        return (np.asarray(betas, dtype=np.float64) @ self.factor.T).astype(np.float32)

    def check(self, signature: Signature) -> None:
        """Raises InputError where the signature is none, or speaks another prior's language."""
        if not isinstance(signature, Signature):
            cure = "of an estimate, omad.applications.retrieval.signature.estimate_signature makes it"
            raise InputError(f"signature: is {type(signature).__name__}; give a Signature: {cure}")
        self.check_prior(signature.prior)
        size = len(self.factor)
        numbers(signature.beta, size, what="beta")
        if signature.covariance is not None:
            known = numbers(signature.covariance, size, size, what="covariance of beta")
            if (np.diagonal(known) < 0).any():
                raise InputError("covariance of beta: has variances below zero; leave it out")

    def check_prior(self, prior: str) -> None:
        """Raises InputError for another prior's fingerprint."""
        if prior != self.prior:
            both = f"the signature is of prior {prior}, the index of prior {self.prior} ({self.category})"
            cure = "use the weights that made the index, or build it anew"
            raise InputError(f"{both}: their betas do not compare; {cure}")

    def check_same(self, other: Self, source: str | Path, place: str | Path) -> None:
        """Raises InputError where that of a catalogue at ``source`` is another one than this, of that at ``place``."""
        same = other.prior == self.prior and other.metric == self.metric
        if not same or not np.allclose(other.factor, self.factor, atol=ROUNDED):  # processors round otherwise
            raise InputError(f"{source}: is of other weights or another metric than {place}; build it anew")


def prior_fingerprint(prior: OmadPrior, category: Category) -> str:
    """Tells one prior from another: 16 hexadecimal digits of the category's parts and unit, and of what beta moves."""
    parts = [(part.name, part.keypoints, part.mirror) for part in category.parts]
    digest = hashlib.sha256(repr((category.name, category.metres_per_unit, parts)).encode())
    for basis in (prior.learned_basis, prior.pivot_basis):
        digest.update(np.ascontiguousarray(basis.detach().cpu().numpy(), dtype="<f4").tobytes())
    return digest.hexdigest()[:16]


def estimate_signature(estimate: Estimate, prior: str) -> Signature:
    """Of an observed object; ``prior`` is the fingerprint of the estimator's."""
    covariance = estimate.covariance[-len(estimate.beta) :, -len(estimate.beta) :]
    mirrored = None
    if estimate.category.either_hand:
        sure = UNTOLD if estimate.hand_probability is None else estimate.hand_probability
        mirrored = sure if estimate.of_other_hand else 1 - sure
    return Signature(prior, estimate.beta, covariance if np.isfinite(covariance).all() else None, mirrored)


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


def check_one_hand(signatures: Sequence[Signature]) -> list[str]:
    """What to warn of where views that are said to be of one object look like objects of different hands. Raises
    InputError where that is sure."""
    hands = {signature.of_other_hand for signature in signatures}
    if {True, False} <= hands:
        cure = "they are of two objects; ask with those of each alone"
        raise InputError(f"some of the views show an object, others one of the other hand (its mirror image): {cure}")
    told = [one.mirrored_probability for one in signatures if one.mirrored_probability is not None]
    if len({probability > 0.5 for probability in told}) > 1:
        said = "some of the views look like an object of the other hand (a mirror image) and do not count"
        return [f"hand: {said}: a door that is all but shut shows little of its hinges; ask with each view alone"]
    return []


def fuse(signatures: Sequence[Signature]) -> Signature:
    """One object's signature from several views of it: the mean, each weighted by its information (inverse covariance)
    where all have one. Where some look like its mirror image only those of the likelier hand count. Raises InputError
    for none, and for signatures of several priors."""
    if not signatures:
        raise InputError("no view to take a signature from; give at least one")
    prior = prior_of(signatures)
    mirrored, signatures = _of_likelier_hand(signatures)
    betas = np.stack([signature.beta for signature in signatures])
    covariances = [signature.covariance for signature in signatures if signature.covariance is not None]
    if len(covariances) < len(signatures):
        return Signature(prior, betas.mean(0), None, mirrored)
    each = np.stack([information(covariance) for covariance in covariances])
    covariance = np.linalg.inv(each.sum(0))
    beta = covariance @ np.einsum("vij,vj->i", each, betas)
    return Signature(prior, beta, covariance, mirrored)


def prior_of(signatures: Sequence[Signature]) -> str:
    """Fingerprint of the prior that all are of. Raises InputError where they are of several."""
    prior, *others = {signature.prior for signature in signatures}
    if others:
        raise InputError("the signatures are of several priors; estimate all with the same weights")
    return prior


def _of_likelier_hand(signatures: Sequence[Signature]) -> tuple[float | None, Sequence[Signature]]:
    """Probability that the object is of the other hand, by the mean of the views' log-odds, and the views that agree;
    all where nothing tells."""
    told = [one.mirrored_probability for one in signatures if one.mirrored_probability is not None]
    if len(told) < len(signatures):
        return None, signatures
    odds = logit(np.clip(told, 1 - SUREST, SUREST))
    mirrored = bool(odds.mean() > 0)
    agreeing = [one for one, own in zip(signatures, odds, strict=True) if (own > 0) == mirrored]
    return float(expit(odds.mean())), agreeing
