"""What takes long to work out of many views, kept on disk some hundreds of views at a time: a run that was stopped goes
on where it was.

<folder>/0000.npz, 0001.npz, ...      rows of consecutive views, with a record of what made them
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import InputError
from ..experiments.predictions import Identity, load_arrays, save_arrays
from ..standard_views import View

Arrays = dict[str, np.ndarray]
"""Arrays with a row a view."""

BATCH = 32
"""Views that are described at once."""
SHARD = 256
"""Views in a file, a multiple of ``BATCH``: half a minute's work."""


def described_in_shards(
    folder: Path,
    identity: Identity,
    total: int,
    views: Callable[[int], Iterable[View]],
    describe: Callable[[list[View]], Arrays],
) -> Arrays:
    """What ``describe`` says of all views, in their order; ``views(n)`` gives those behind the first n.

    Raises InputError where the folder holds what was made of other data, weights or settings.
    """
    shards = list(_kept(folder, identity))
    done = sum(_rows(shard) for shard in shards)
    if done < total:
        batches: list[Arrays] = []
        bar = tqdm(total=total, initial=done, unit="view", file=sys.stderr, disable=not sys.stderr.isatty())
        for some in _batched(views(done)):
            batches.append(describe(some))
            bar.update(len(some))
            if sum(_rows(batch) for batch in batches) >= SHARD:
                shards.append(_save(folder, len(shards), identity, batches))
                batches = []
        if batches:
            shards.append(_save(folder, len(shards), identity, batches))
        bar.close()
    if not shards:
        raise InputError(f"{folder}: there is no view to look at; give a source that holds some")
    return _joined(shards)


def _kept(folder: Path, identity: Identity) -> Iterator[Arrays]:
    """Shards from the first one on, as many as follow each other."""
    number = 0
    while (arrays := load_arrays(_file(folder, number), identity)) is not None:
        yield arrays
        number += 1


def _save(folder: Path, number: int, identity: Identity, batches: list[Arrays]) -> Arrays:
    shard = _joined(batches)
    save_arrays(_file(folder, number), identity, **shard)
    return shard


def _file(folder: Path, number: int) -> Path:
    return folder / f"{number:04d}.npz"


def _joined(parts: list[Arrays]) -> Arrays:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _rows(arrays: Arrays) -> int:
    return len(next(iter(arrays.values())))


def _batched(views: Iterable[View]) -> Iterator[list[View]]:
    some: list[View] = []
    for view in views:
        some.append(view)
        if len(some) == BATCH:
            yield some
            some = []
    if some:
        yield some
