"""The user's cache folder: what can be made or fetched again, and need not be."""

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from .errors import InputError

VARIABLE = "OMAD_CACHE"


def user_cache(*names: str) -> Path:
    """A folder in the user's cache, which is made: in ``OMAD_CACHE`` where that is set, else where the system keeps
    such things. Raises InputError where it cannot be made."""
    told = os.environ.get(VARIABLE)
    try:
        folder = (Path(told) if told else _caches() / "omad").joinpath(*names)
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: who runs this has no home
        cure = f"set {VARIABLE} to a folder that can be written"
        raise InputError(f"the user's cache cannot be used ({error}); {cure}") from error
    return folder


def _caches() -> Path:
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def kept_at(given: Path | None, kind: str, name: str, made_of: Mapping[str, str]) -> Path:
    """Where what is ``made_of`` these is kept: as ``name`` in the folder given; or in the user's cache under a name of
    its own, so that what is made of other things never stands in the way."""
    if given is not None:
        return given / name
    digest = hashlib.sha256(json.dumps(dict(made_of), sort_keys=True).encode()).hexdigest()
    return user_cache(kind) / f"{name}-{digest[:16]}"
