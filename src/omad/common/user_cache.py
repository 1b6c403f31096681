"""The user's cache folder: what can be made or fetched again, and need not be."""

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path

VARIABLE = "OMAD_CACHE"


def user_cache(*names: str) -> Path:
    """A folder in the user's cache: in ``OMAD_CACHE`` where that is set, else where the system keeps such things."""
    if told := os.environ.get(VARIABLE):
        return Path(told).joinpath(*names)
    if sys.platform == "darwin":
        folder = Path.home() / "Library" / "Caches"
    elif os.name == "nt":
        folder = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return folder.joinpath("omad", *names)


def kept_at(given: Path | None, kind: str, name: str, made_of: Mapping[str, str]) -> Path:
    """Where what is ``made_of`` these is kept: as ``name`` in the folder given; or in the user's cache under a name of
    its own, so that what is made of other things never stands in the way."""
    if given is not None:
        return given / name
    digest = hashlib.sha256(json.dumps(dict(made_of), sort_keys=True).encode()).hexdigest()
    return user_cache(kind, f"{name}-{digest[:16]}")
