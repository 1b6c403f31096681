"""What OMAD and the Siamese network say of many views of many objects, kept on disk with a record of its making.

<cache>/<category>/omad/         shards: objects, joint states, and of every view beta (initial, refined), covariance
<cache>/<category>/siamese/      shards: the embedding of every view
"""

from collections.abc import Iterable, Sized
from dataclasses import dataclass

import numpy as np

from omad.data.rendering.standard_views import View, observe_all
from omad.estimation.estimator import Estimator

from ..baselines.siamese import SiameseEncoder
from .shards import Arrays


@dataclass(frozen=True)
class Pool:
    """V views and OMAD's signatures of them; NaN where there was nothing to estimate."""

    objects: np.ndarray
    """(V,) names."""
    states: np.ndarray
    """(V, J) true joint states, radians or metres."""
    beta: np.ndarray
    """(V, D) refined."""
    initial: np.ndarray
    """(V, D) the network's own."""
    covariance: np.ndarray
    """(V, D, D) of the refined beta."""


def describe_with_omad(estimator: Estimator, views: list[View]) -> Arrays:
    """The arrays of a ``Pool`` of these views."""
    size = estimator.net.prior.basis_size
    observed = observe_all(views)
    found = estimator(list(observed.values())) if observed else []
    return {
        "objects": np.array([view.object for view in views]),
        "states": np.stack([view.states for view in views]),
        "beta": _rows(views, observed, [e.beta for e in found], size),
        "initial": _rows(views, observed, [e.initial.beta for e in found], size),
        "covariance": _rows(views, observed, [e.covariance[-size:, -size:] for e in found], size, size),
    }


def describe_with_siamese(encoder: SiameseEncoder, views: list[View]) -> Arrays:
    """``embeddings`` (V, E) of these views."""
    observed = observe_all(views)
    embedded = encoder(list(observed.values())) if observed else []
    return {"embeddings": _rows(views, observed, embedded, encoder.net.size)}


def _rows(views: Sized, observed: Iterable[int], found: Iterable[np.ndarray], *shape: int) -> np.ndarray:
    """(V, *shape): what was ``found`` of the ``observed`` views; NaN of the others, which show too little."""
    rows = np.full((len(views), *shape), np.nan)
    for index, row in zip(observed, found, strict=True):
        rows[index] = row
    return rows
