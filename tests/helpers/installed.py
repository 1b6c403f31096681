"""Whether an optional library is there."""

from importlib.util import find_spec


def installed(name: str) -> bool:
    """Of a top-level module, without importing it."""
    return find_spec(name) is not None
