"""Options that many commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

Json = Annotated[bool, tyro.conf.arg(help="Print one JSON object on stdout and nothing else there.")]
Device = Annotated[str, tyro.conf.arg(help="cpu, cuda, or auto: CUDA where there is one.")]
Weights = Annotated[Path | None, tyro.conf.arg(help="Checkpoint folder in place of the shipped weights.")]
Result = tuple[int, dict[str, Any]]
