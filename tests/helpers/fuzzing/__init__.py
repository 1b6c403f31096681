"""The project's own fuzzer: readers, commands and functions with input that no friend would give them."""

from pathlib import Path

from .calls import calls
from .commands import commands
from .readers import readers
from .trial import Call, Command, Target

__all__ = ["Call", "Command", "Target", "targets"]


def targets(folder: Path) -> list[Target | Command | Call]:
    """All there is to try; good files are made in ``folder``."""
    for name in ("readers", "commands"):
        (folder / name).mkdir(parents=True)
    return [*readers(folder / "readers"), *calls(), *commands(folder / "commands")]
