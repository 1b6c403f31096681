"""Checkpoints at an address, ``https://``, ``s3://``, ``file://`` or any other that fsspec knows: fetched once, checked
and kept in the user's cache.

An address is that of a checkpoint folder with ``manifest.json``, which names its files with their sizes and SHA-256;
``omad export`` writes it. Only numbers and tables are taken (``SUFFIXES``): nothing that runs when it is read. With
``#sha256=...`` at the end of the address, the manifest itself must have that sum, so that whoever holds the server
cannot change what is read; without, ``https`` or another trusted transport is needed."""

import hashlib
import re
import urllib.request
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any
from urllib.parse import urlsplit

from omad.common.decode import Within
from omad.common.errors import InputError
from omad.common.files import make_folder, write_atomic, write_json
from omad.common.incoming import decoded, parse_json
from omad.common.limits import limits
from omad.common.user_cache import user_cache

MANIFEST = "manifest.json"
SUFFIXES = (".json", ".safetensors", ".npz")
PINNED = "#sha256="
UNTRUSTED = ("http", "ftp")
"""Transports that anyone in between may change."""
MOST_FILES = 100
SECONDS = 60.0


@dataclass(frozen=True)
class StoredFile:
    """One file of a checkpoint."""

    sha256: str
    bytes: Annotated[int, Within(0, 2**40)]


@dataclass(frozen=True)
class Manifest:
    """What a checkpoint at an address is made of."""

    files: dict[str, StoredFile]
    """By their names in the folder, with / between its parts."""

    def __post_init__(self) -> None:
        if not 1 <= len(self.files) <= MOST_FILES or "config.json" not in self.files:
            raise ValueError(f"files: {len(self.files)} files, or no config.json; give those of a checkpoint")
        for name, file in self.files.items():
            path = PurePosixPath(name)
            odd = not re.fullmatch(r"[\w.-]+(/[\w.-]+)*", name) or ".." in path.parts or path.is_absolute()
            if odd or path.suffix not in SUFFIXES:
                raise ValueError(
                    f"files: {name!r} is no file of a checkpoint; give {', '.join(SUFFIXES)} in its folder"
                )
            if not re.fullmatch(r"[0-9a-f]{64}", file.sha256):
                raise ValueError(f"files: {name!r} has no SHA-256; write the manifest anew")
        if sum(file.bytes for file in self.files.values()) > limits().data_bytes:
            raise ValueError("files: are too large together; give a checkpoint")


def fetch(address: str) -> Path:
    """The folder in the user's cache that holds the checkpoint at an address. What is there already is not fetched
    again; where the address cannot be reached, it is used as it is. Raises InputError for what cannot be fetched, is
    not what its manifest says, or is not safe to read."""
    address, _, pinned = address.partition(PINNED)
    address = address.rstrip("/")
    if not pinned and address.split(":", 1)[0] in UNTRUSTED:
        cure = f"use https, or add {PINNED}... of its {MANIFEST}"
        raise InputError(f"{address}: anyone in between may change what http brings; {cure}")
    kept = user_cache("weights", _short_sum(f"{address}{pinned}".encode())) / MANIFEST
    if kept.is_file() and pinned:
        return _folder_of(kept)
    try:
        stored = _read(f"{address}/{MANIFEST}", limits().text_bytes)
    except InputError:
        if kept.is_file():
            return _folder_of(kept)
        raise
    if pinned and hashlib.sha256(stored).hexdigest() != pinned.lower():
        raise InputError(
            f"{address}/{MANIFEST}: is not the one with {PINNED[1:]}{pinned}; ask who gave you the address"
        )
    if kept.is_file() and kept.read_bytes() == stored:
        return _folder_of(kept)
    manifest = _manifest(stored, f"{address}/{MANIFEST}")
    for name, file in manifest.files.items():
        _fetch_file(f"{address}/{name}", file, kept.parent / _short_sum(stored) / name)
    write_atomic(kept, lambda path: path.write_bytes(stored))  # the last: where it is, all that it names is there
    return _folder_of(kept)


def _folder_of(kept: Path) -> Path:
    """That of the files which a kept manifest names. Another manifest's have one of their own, so that an update which
    is cut short leaves them whole."""
    return kept.parent / _short_sum(kept.read_bytes())


def _short_sum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def write_manifest(folder: Path) -> None:
    """Name the files of a checkpoint folder, so that it can be fetched from wherever it is put."""
    files = {}
    for path in sorted(path for path in folder.rglob("*") if path.suffix in SUFFIXES and path.name != MANIFEST):
        content = path.read_bytes()
        name = path.relative_to(folder).as_posix()
        files[name] = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
    write_json(folder / MANIFEST, {"files": files}, indent=1)


def _manifest(stored: bytes, name: str) -> Manifest:
    cure = "write it anew with omad export"
    values = parse_json(stored, name, cure)
    if not isinstance(values, dict):
        raise InputError(f"{name}: holds no table; {cure}")
    return decoded(Manifest, values, name, cure)


def _fetch_file(address: str, file: StoredFile, path: Path) -> None:
    content = _read(address, file.bytes)
    if len(content) != file.bytes or hashlib.sha256(content).hexdigest() != file.sha256:
        raise InputError(f"{address}: is not what the manifest says (its SHA-256 differs); upload it anew")
    make_folder(path.parent)
    write_atomic(path, lambda temporary: temporary.write_bytes(content))


def _read(address: str, most: int) -> bytes:
    """At most so many bytes, and one more."""
    scheme = address.split(":", 1)[0]
    try:
        with _opened(address, scheme) as file:
            content = file.read(most + 1)
    except InputError:
        raise
    except Exception as error:  # whatever a file system raises
        reason = getattr(error, "reason", None) or error
        missing = isinstance(error, ImportError)  # fsspec is there, what it needs for such addresses is not
        cure = "install what it asks for with pip" if missing else "check the address"
        raise InputError(f"{address}: cannot be fetched ({type(error).__name__}: {reason}); {cure}") from error
    if len(content) > most:
        raise InputError(f"{address}: is larger than {most} bytes; check the address")
    return content


class _Redirects(urllib.request.HTTPRedirectHandler):
    """From https, no server may send on to what anyone in between may change."""

    def redirect_request(self, req: Any, fp: Any, code: int, msg: str, headers: Any, newurl: str) -> Any:
        if req.type not in UNTRUSTED and urlsplit(newurl).scheme in UNTRUSTED:
            cure = "ask who gave you the address for one that stays with https"
            raise InputError(f"{req.full_url}: sends on to {newurl}, which anyone in between may change; {cure}")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _opened(address: str, scheme: str) -> Any:
    if scheme in ("http", "https"):
        return urllib.request.build_opener(_Redirects).open(address, timeout=SECONDS)
    try:
        import fsspec
    except ImportError as error:
        raise InputError(f"{address}: needs fsspec; pip install 'omad[remote]'") from error
    files: Any = fsspec.open(address, "rb")
    return files.open()
