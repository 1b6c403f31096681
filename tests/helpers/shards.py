"""Work in shards that fails as it is told to, in a module that other processes can import."""

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omad.common.errors import InputError
from omad.data.shards.parquet import import_pyarrow


@dataclass(frozen=True)
class Squares:
    """Of the numbers from 0; a line in ``log`` for each shard that is begun."""

    folder: Path
    fails: tuple[int, ...] = ()
    """Where a shard begins that fails the first time."""
    kills: tuple[int, ...] = ()
    """Where one begins that ends its process the first time."""
    bad: tuple[int, ...] = ()
    short: bool = False

    def __call__(self, start: int, stop: int) -> list[dict[str, Any]]:
        with (self.folder / "log").open("a") as log:
            log.write(f"{start}\n")
        if start in self.bad:
            raise InputError(f"{start}: is bad; leave it out")
        if start in (*self.fails, *self.kills) and not (self.folder / f"failed-{start}").exists():
            (self.folder / f"failed-{start}").touch()
            if start in self.kills:
                os.kill(os.getpid(), signal.SIGKILL)
            raise OSError("the network is down")
        return [{"number": i, "square": i * i} for i in range(start, stop - self.short)]

    def schema(self) -> Any:
        pyarrow = import_pyarrow()
        return pyarrow.schema({"number": pyarrow.int64(), "square": pyarrow.int64()})

    def refused(self, row: dict[str, Any]) -> bool:
        return row["number"] % 10 == 0

    def begun(self) -> list[int]:
        return [int(line) for line in (self.folder / "log").read_text().split()]
