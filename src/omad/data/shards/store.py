"""Where shards lie: a folder, or an address that fsspec knows (``s3://``, ``gs://``, ``hdfs://`` ...)."""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, cast
from uuid import uuid4

from omad.common.errors import InputError
from omad.common.files import TEMPORARY, make_folder, one_line, stamp, write_atomic
from omad.common.incoming import address_of

OBJECT_STORES = {"s3", "gs", "gcs", "abfs", "az", "oss", "oci", "memory"}
"""What fsspec calls file systems that have no renaming, and need none."""


@dataclass(frozen=True)
class Store:
    """Files by their names, in one place that every process reaches by the same name."""

    place: str
    """A path, or an address."""

    @classmethod
    def of(cls, place: str | Path) -> "Store":
        """Raises InputError for an address whose file system is not installed."""
        store = cls(address_of(place) or os.path.abspath(place))
        if store._address is not None:
            _ = store._system
        return store

    def names(self) -> set[str]:
        """Of the files that are there."""
        if self._address is None:
            return {entry.name for entry in os.scandir(self.place)} if os.path.isdir(self.place) else set()
        system, root = self._system
        try:
            names = {path.rsplit("/", 1)[-1] for path in system.ls(root, detail=False)}
        except FileNotFoundError:
            return set()
        return {name for name in names if not name.startswith(TEMPORARY)}

    def has(self, name: str) -> bool:
        """Whether a file is there."""
        if self._address is None:
            return Path(self.place, name).is_file()
        system, root = self._system
        return system.exists(f"{root}/{name}")

    def stamp(self, name: str) -> str:
        """Another one when a file is written anew: its size and when it was written, as far as that is told. Raises
        OSError."""
        if self._address is None:
            return stamp(Path(self.place, name))
        system, root = self._system
        told = system.info(f"{root}/{name}")
        return " ".join(str(told.get(key)) for key in ("size", "mtime", "LastModified", "updated", "etag", "ETag"))

    def open(self, name: str) -> BinaryIO:
        """To read. Raises OSError."""
        if self._address is None:
            return Path(self.place, name).open("rb")
        system, root = self._system
        return cast(BinaryIO, system.open(f"{root}/{name}", "rb"))

    def read(self, name: str) -> bytes:
        """All of a file. Raises OSError."""
        with self.open(name) as file:
            return file.read()

    def write(self, name: str, content: bytes) -> None:
        """Whole or not at all; in place of what has that name. Raises InputError, WorkError, OSError."""
        if self._address is None:
            make_folder(self.place)
            write_atomic(Path(self.place, name), lambda path: path.write_bytes(content))
            return
        system, root = self._system
        system.makedirs(root, exist_ok=True)
        if OBJECT_STORES.intersection([system.protocol] if isinstance(system.protocol, str) else system.protocol):
            system.pipe_file(f"{root}/{name}", content)  # which show an object when all of it is there
            return
        system.pipe_file(temporary := f"{root}/{TEMPORARY}{uuid4().hex}", content)
        system.mv(temporary, f"{root}/{name}")

    @cached_property
    def _address(self) -> str | None:
        return address_of(self.place)

    @cached_property
    def _system(self) -> tuple[Any, str]:
        try:
            from fsspec.core import url_to_fs  # pyright: ignore[reportMissingImports]

            system, root = url_to_fs(self.place)
        except Exception as error:  # of a file system that is not installed, or a bad address
            cure = "pip install 'omad[cluster]' and what fsspec asks for"
            raise InputError(f"{self.place}: cannot be reached ({one_line(error)}); {cure}") from error
        return system, root.rstrip("/")
