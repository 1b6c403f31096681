"""What takes long to work out of many views, kept on disk some hundreds of views at a time: a run that was stopped goes
on where it was.

<folder>/0000.npz, 0001.npz, ...      rows of consecutive views, with a record of what made them
"""

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from omad.common.arrays import Identity, load_arrays, save_arrays
from omad.common.batches import batched
from omad.common.errors import InputError
from omad.common.stderr import is_watched
from omad.data.rendering.standard_views import View

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
    """What ``describe`` says of all views, in their order; ``views(n)`` gives those behind the first n. Raises
    InputError where the folder holds what was made of other data, weights or settings."""
    shards: list[Arrays] = []
    while (kept := load_arrays(_file(folder, len(shards)), identity)) is not None:
        shards.append(kept)
    done = sum(len(next(iter(shard.values()))) for shard in shards)
    if done < total:
        bar = {"total": total, "initial": done, "unit": "view", "disable": not is_watched()}
        seen = batched(tqdm(views(done), file=sys.stderr, **bar), BATCH)
        for parts in batched(map(describe, seen), SHARD // BATCH):
            shard = _joined(parts)
            save_arrays(_file(folder, len(shards)), identity, **shard)
            shards.append(shard)
    if not shards:
        raise InputError(f"{folder}: there is no view to look at; give a source that holds some")
    return _joined(shards)


def _file(folder: Path, number: int) -> Path:
    return folder / f"{number:04d}.npz"


def _joined(parts: list[Arrays]) -> Arrays:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
