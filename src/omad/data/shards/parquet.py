"""The files of a run in shards.

<place>/_run.json          what the rows are made of, how many there are (``total``) and how many a file has (``shard``)
<place>/part-000000.parquet, part-000001.parquet ...
"""

from typing import Any

from omad.common.errors import InputError

RUN = "_run.json"
"""Engines for Parquet pass over names that begin so."""


def part_name(number: int) -> str:
    """Of a shard's file."""
    return f"part-{number:06d}.parquet"


def import_pyarrow() -> Any:
    """The package, with ``pyarrow.parquet``. Raises InputError where it is not installed."""
    try:
        import pyarrow.parquet  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InputError("Parquet files need PyArrow, which is not installed: pip install 'omad[parquet]'") from error
    return pyarrow
