"""Options that many commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from .errors import InputError

Json = Annotated[bool, tyro.conf.arg(help="Print one JSON object on stdout and nothing else there.")]
Device = Annotated[str, tyro.conf.arg(help="cpu, cuda, or auto: CUDA where there is one.")]
Weights = Annotated[Path | None, tyro.conf.arg(help="Checkpoint folder in place of the shipped weights.")]
Result = tuple[int, dict[str, Any]]


def check_positive(**counts: float | None) -> None:
    """Raises InputError for an option below one; None is an option that was not given."""
    for name, value in counts.items():
        if value is not None and value <= 0:
            raise InputError(f"--{name.replace('_', '-')} {value}: must be at least 1")
