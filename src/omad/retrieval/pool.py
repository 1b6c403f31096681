"""What OMAD and the Siamese network say of many views of many objects, kept on disk with a record of its making.

<cache>/<category>/omad.npz      objects, joint states, and of every view beta (initial and refined) with covariance
<cache>/<category>/siamese.npz   the embedding of every view
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import InputError
from ..estimator import Estimator
from ..experiments.predictions import Identity, load_arrays, save_arrays
from ..observation import Observation
from ..standard_views import View
from .siamese_encoder import SiameseEncoder

BATCH = 32


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


def describe_with_omad(estimator: Estimator, views: Iterable[View], total: int) -> Pool:
    """Estimate every view."""
    objects, states, rows = [], [], []
    size = estimator.net.prior.basis_size

    def estimate(observations: list[Observation]) -> list[np.ndarray]:
        found = estimator(observations)
        return [np.concatenate([e.beta, e.initial.beta, e.covariance[-size:, -size:].ravel()]) for e in found]

    for some in _batched(views, total):
        objects += [view.object for view in some]
        states += [view.states for view in some]
        rows.append(_of_seen(some, estimate, 2 * size + size**2))
    found = np.concatenate(rows)
    return Pool(
        objects=np.array(objects),
        states=np.stack(states),
        beta=found[:, :size],
        initial=found[:, size : 2 * size],
        covariance=found[:, 2 * size :].reshape(-1, size, size),
    )


def describe_with_siamese(encoder: SiameseEncoder, views: Iterable[View], total: int) -> np.ndarray:
    """Embed every view, (V, E)."""

    def embed(observations: list[Observation]) -> list[np.ndarray]:
        return list(encoder(observations))

    return np.concatenate([_of_seen(some, embed, encoder.net.size) for some in _batched(views, total)])


def _batched(views: Iterable[View], total: int) -> Iterable[list[View]]:
    some: list[View] = []
    for view in tqdm(views, total=total, unit="view", file=sys.stderr, disable=not sys.stderr.isatty()):
        some.append(view)
        if len(some) == BATCH:
            yield some
            some = []
    if some:
        yield some


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


def save_pool(path: Path, pool: Pool, identity: Identity) -> None:
    save_arrays(path, identity, **{f.name: getattr(pool, f.name) for f in fields(Pool)})


def load_pool(path: Path, identity: Identity) -> Pool | None:
    """None where there is no such file. Raises InputError where it is of other data or weights."""
    arrays = load_arrays(path, identity)
    return None if arrays is None else Pool(**arrays)
