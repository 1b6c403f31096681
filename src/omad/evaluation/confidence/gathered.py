"""Numbers of many views, worked out a few at a time, and kept so that what was interrupted goes on."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from omad.common.arrays import Identity, load_arrays, save_arrays
from omad.common.batches import progress
from omad.common.errors import InputError

Rows = dict[str, np.ndarray]
"""Arrays (n, ...) by name, all of as many rows; none at all where there are no rows."""


@dataclass(frozen=True)
class Begun:
    """A folder of what is worked out so far."""

    folder: Path
    made_of: Identity
    """All that it depends on; what was made of other things is made anew."""

    def end(self) -> None:
        """It is not needed any more."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def load(self, name: str) -> Rows | None:
        """None where it is not there, cannot be read, or was made of something else."""
        try:
            return load_arrays(self.folder / name, self.made_of)
        except InputError:
            return None

    def save(self, name: str, rows: Rows) -> None:
        """Raises InputError, and WorkError where the disk is full."""
        save_arrays(self.folder / name, self.made_of, **rows)


def gathered(made: Callable[[range], Rows], most: int, size: int, name: str, begun: Begun | None) -> Rows:
    """The first ``most`` rows of what is ``made`` of 0, 1, 2 and so on, of which each makes a row or none; ``size``: of
    at most so many at a time, nothing where they make none. ``name``: tells it from other work in the same folder."""
    found, first, done = list[Rows](), 0, 0

    def indices() -> range:
        return range(first, first + min(size, most - done))

    def take(some: Rows) -> int:
        nonlocal first, done
        count = len(next(iter(some.values()), ()))
        first, done = indices().stop, done + count
        found.append(some)
        return count

    while done < most and begun is not None and (kept := begun.load(f"{name}-{first}.npz")) is not None:
        take(kept)

    def rest() -> Iterator[int]:
        while done < most:
            some = made(indices())
            if begun is not None:
                begun.save(f"{name}-{first}.npz", some)
            yield from range(take(some))

    for _ in progress(rest(), most, done=done, every=30.0):
        pass
    some = [each for each in found if each]
    return {key: np.concatenate([each[key] for each in some]) for key in some[0]}
