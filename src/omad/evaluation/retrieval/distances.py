"""How unlike queries and a gallery's views are, by every method that is compared."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from omad.applications.retrieval.signature import Signature, Space, fuse, information_factor
from omad.model.prior import OmadPrior
from omad.objects.category import Category

from .pool import Pool

TOGETHER = 3
"""Views of one object that a query of several views has."""


@dataclass(frozen=True)
class Ranker:
    """A way to rank the views of a gallery."""

    distance: Callable[[np.ndarray, np.ndarray], np.ndarray]
    """From rows of a pool, of the queries (Q, views) and of the gallery (G,), to distances (Q, G)."""
    views: int = 1
    """Of one object in a query."""


def methods(pool: Pool, embeddings: np.ndarray | None, prior: OmadPrior, category: Category) -> dict[str, Ranker]:
    """``omad`` and ``omad_initial`` are the Euclidean distance of beta, as in the paper. ``omad_keypoints`` compares
    refined betas as ``omad index`` does, by the distance between canonical keypoints; ``omad_whitened`` in the prior's
    standard deviations, ``omad_information`` in those of query and gallery. ``omad_three_views`` is ``omad_keypoints``
    with several views fused into a query. ``siamese``, where there are ``embeddings`` (V, E), is Euclidean, and
    ``siamese_three_views`` takes their mean."""
    keypoints = Space.of(prior, category, "keypoints").factor
    whitened = Space.of(prior, category, "whitened").factor
    found = {
        "omad": Ranker(between(pool.beta)),
        "omad_initial": Ranker(between(pool.initial)),
        "omad_keypoints": Ranker(between(pool.beta, keypoints)),
        "omad_whitened": Ranker(between(pool.beta, whitened)),
        "omad_information": Ranker(by_information(pool.beta, pool.covariance)),
        "omad_three_views": Ranker(of_fused(pool, keypoints), TOGETHER),
    }
    if embeddings is not None:
        found["siamese"] = Ranker(between(embeddings))
        found["siamese_three_views"] = Ranker(between(embeddings), TOGETHER)
    return found


def between(vectors: np.ndarray, factor: np.ndarray | None = None) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Euclidean distance of ``factor @ vector`` of vectors (V, D), of the mean of a query's views."""
    compared = vectors if factor is None else vectors @ factor.T

    def distance(queries: np.ndarray, gallery: np.ndarray) -> np.ndarray:
        return _euclidean(compared[queries].mean(1), compared[gallery])

    return distance


def by_information(betas: np.ndarray, covariances: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """What ``ShapeIndex.search`` does by information: of single views with betas (V, D), covariances (V, D, D)."""

    def distance(queries: np.ndarray, gallery: np.ndarray) -> np.ndarray:
        usual = np.nanmean(covariances[gallery], axis=0)
        rows = np.full((len(queries), len(gallery)), np.nan)
        for number, query in enumerate(queries[:, 0]):
            if np.isfinite(covariances[query]).all():
                factor = information_factor(covariances[query], usual)
                rows[number] = _euclidean(betas[query][None] @ factor.T, betas[gallery] @ factor.T)[0]
        return rows

    return distance


def of_fused(pool: Pool, factor: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """As ``between`` of refined betas, of queries that are fused as ``omad index query`` fuses its inputs; views that
    showed nothing are left out."""

    def beta(views: np.ndarray) -> np.ndarray:
        seen = views[np.isfinite(pool.covariance[views]).all((1, 2))]
        each = [Signature("", pool.beta[view], pool.covariance[view]) for view in seen]
        return fuse(each).beta if each else np.full(pool.beta.shape[1], np.nan)

    def distance(queries: np.ndarray, gallery: np.ndarray) -> np.ndarray:
        return _euclidean(np.stack([beta(views) for views in queries]) @ factor.T, pool.beta[gallery] @ factor.T)

    return distance


def _euclidean(queries: np.ndarray, gallery: np.ndarray) -> np.ndarray:
    """(Q, G) from (Q, D) and (G, D)."""
    return np.linalg.norm(queries[:, None] - gallery[None], axis=-1)
