"""What OMAD and the Siamese network say of many views of many objects, kept on disk with a record of its making.

<cache>/<category>/omad/         shards: objects, joint states, and of every view beta (initial, refined), covariance
<cache>/<category>/siamese/      shards: the embedding of every view
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..estimator import Estimator
from ..observation import Observation
from ..standard_views import View
from .shards import Arrays
from .siamese_encoder import SiameseEncoder


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

    def estimate(observations: list[Observation]) -> list[np.ndarray]:
        found = estimator(observations)
        return [np.concatenate([e.beta, e.initial.beta, e.covariance[-size:, -size:].ravel()]) for e in found]

    rows = _of_seen(views, estimate, 2 * size + size**2)
    return {
        "objects": np.array([view.object for view in views]),
        "states": np.stack([view.states for view in views]),
        "beta": rows[:, :size],
        "initial": rows[:, size : 2 * size],
        "covariance": rows[:, 2 * size :].reshape(-1, size, size),
    }


def describe_with_siamese(encoder: SiameseEncoder, views: list[View]) -> Arrays:
    """``embeddings`` (V, E) of these views."""

    def embed(observations: list[Observation]) -> list[np.ndarray]:
        return list(encoder(observations))

    return {"embeddings": _of_seen(views, embed, encoder.net.size)}


def _of_seen(views: list[View], describe: Callable[[list[Observation]], list[np.ndarray]], width: int) -> np.ndarray:
    """(B, width) of the views that show enough; NaN of the others."""
    rows = np.full((len(views), width), np.nan)
    observed: dict[int, Observation] = {}
    for number, view in enumerate(views):
        try:
            observed[number] = Observation.from_depth(view.depth, view.camera)
        except InputError:  # too little of the object is left to be seen
            continue
    if observed:
        rows[list(observed)] = describe(list(observed.values()))
    return rows
