"""How unlike two views are, by every method that is compared: (Q, G) distances between views of a pool."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..categories import Category
from ..prior import OmadPrior
from .pool import Pool
from .signature import Space

Distance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From rows of the queries (Q,) and of the gallery (G,) in a pool to (Q, G)."""


def methods(pool: Pool, embeddings: np.ndarray | None, prior: OmadPrior, category: Category) -> dict[str, Distance]:
    """``omad`` and ``omad_initial`` are Euclidean distances of beta, as in the paper; ``omad_keypoints``,
    ``omad_whitened`` compare refined betas in those spaces; ``omad_information`` in the query's own standard
    deviations; ``siamese``, where there are ``embeddings`` (V, E), is Euclidean."""
    found = {
        "omad": between(pool.beta),
        "omad_initial": between(pool.initial),
        "omad_keypoints": between(pool.beta @ Space.of(prior, category, "keypoints").factor.T),
        "omad_whitened": between(pool.beta @ Space.of(prior, category, "whitened").factor.T),
        "omad_information": by_information(pool.beta, pool.covariance),
    }
    if embeddings is not None:
        found["siamese"] = between(embeddings)
    return found


def between(vectors: np.ndarray) -> Distance:
    """Euclidean distance of vectors (V, D)."""

    def distance(queries: np.ndarray, gallery: np.ndarray) -> np.ndarray:
        return np.linalg.norm(vectors[queries][:, None] - vectors[gallery][None], axis=-1)

    return distance


def by_information(betas: np.ndarray, covariances: np.ndarray) -> Distance:
    """Distance in standard deviations of the difference: the query's covariance and the gallery's mean one."""

    def distance(queries: np.ndarray, gallery: np.ndarray) -> np.ndarray:
        usual = np.nanmean(covariances[gallery], axis=0)
        rows = np.full((len(queries), len(gallery)), np.nan)
        for number, query in enumerate(queries):
            together = covariances[query] + usual
            if np.isfinite(together).all():
                away = betas[gallery] - betas[query]
                rows[number] = np.sqrt(np.einsum("gi,ij,gj->g", away, np.linalg.inv(together), away))
        return rows

    return distance
