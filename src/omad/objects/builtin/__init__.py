"""The shipped categories: spec files that are like a user's own."""

from pathlib import Path

FOLDER = Path(__file__).parent
AUTO = "auto"
"""Stands for any category, and so is the name of none."""


def builtin_names() -> tuple[str, ...]:
    """Of all shipped categories, sorted. Reads no file."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))
