"""Files that come in, from strangers maybe: each kind is opened here, once, within the limits of ``limits.py``.

Whatever is wrong with a file is an InputError of one line that names it. What a file holds is not quoted: whoever may
see the message may not see the file. The values in it are for ``decode.py``.
"""

import hashlib
import io
import json
import math
import os
import re
import stat
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path, PurePath, PureWindowsPath
from typing import Any, TypeVar, cast

import numpy as np
from numpy.lib import format as npy

from .decode import decode
from .errors import SHOWN, InputError, WorkError, shown
from .files import one_line
from .limits import check_limit, limits

IMAGE_FORMATS = ("PNG", "TIFF", "JPEG", "BMP", "PPM", "WEBP", "GIF")
"""What Pillow may take a picture for. Others of its formats start programs, as EPS does."""
CHECKSUM = "sha256"
"""What a file calls its own checksum."""
T = TypeVar("T")


@contextmanager
def readable(path: str | Path, kind: str, cure: str = "export it again") -> Iterator[None]:
    """InputError in place of whatever readers raise for a damaged or foreign file, EOFError to zlib.error."""
    try:
        yield
    except (InputError, WorkError):
        raise
    except RecursionError as error:
        raise InputError(f"{shown(path)}: not readable as {kind} (nested too deeply); {cure}") from error
    except MemoryError as error:
        raise InputError(f"{shown(path)}: not readable as {kind} (it asks for too much memory); {cure}") from error
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"{shown(path)}: not readable as {kind} ({reason}); {cure}") from error
    except Exception as error:
        raise InputError(f"{shown(path)}: not readable as {kind} ({_reason(error)}); {cure}") from error


def _reason(error: Exception) -> str:
    """What a reader says, where it says places rather than content."""
    if isinstance(error, json.JSONDecodeError | tomllib.TOMLDecodeError | UnicodeError):
        text = str(error)
        return f"{type(error).__name__}{text[text.rfind(' (') :] if ' (' in text else ''}"
    text = one_line(error)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


def is_file(path: Any) -> bool:
    """Whether there is such a file; never an error, however odd the path is."""
    try:
        return os.path.isfile(path)
    except (OSError, ValueError, TypeError):
        return False


def is_path(path: Any) -> bool:
    """Whether there is a file or a folder; never an error, however odd the path is."""
    try:
        return os.path.exists(path)
    except (OSError, ValueError, TypeError):
        return False


def address_of(place: str | PurePath) -> str | None:
    """The address (``https://``, ``s3://`` ...) that a place is at; None for what is none, as a folder. A path forgets
    one of two slashes, and turns them round on Windows, where ``C:`` is a drive."""
    found = re.match(r"([A-Za-z][\w+.-]+):[/\\]+", str(place))
    if found is None:
        return None
    scheme = found[1].lower()
    rest = str(place)[found.end() :]
    rest = rest.replace("\\", "/") if isinstance(place, PureWindowsPath) else rest
    return f"{scheme}://{'/' if scheme == 'file' else ''}{rest}"


def as_path(path: Any, what: str) -> Path:
    """A path of whatever a caller gave. Raises InputError for what is none; ``what``: as "a depth image"."""
    if not isinstance(path, str | os.PathLike) or "\0" in os.fspath(path):
        raise InputError(f"{shown(repr(path))}: is no path; give that of {what}")
    return Path(path)


def existing(path: Any, what: str) -> Path:
    """The path of a file that is there. Raises InputError; ``what``: as "a depth image"."""
    found = as_path(path, what)
    if not is_file(found):
        raise InputError(f"{shown(found)}: no such file; give {what}")
    return found


def check_file(path: Path) -> None:
    """Raises OSError, InputError for what is no file: a pipe would be waited for, a device has no end."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise InputError(f"{shown(path)}: is no file; give one")


def read_bytes(path: Path, name: str = "data_bytes") -> bytes:
    """All of a file, within the limit called ``name``. Raises OSError, InputError."""
    check_file(path)
    check_limit(name, path.stat().st_size, f"{path}: the file")
    return path.read_bytes()


def read_text(path: Path, cure: str = "export it again", errors: str = "strict") -> str:
    """UTF-8, without the byte order mark that it may begin with. Raises InputError."""
    with readable(path, "text", cure):
        return read_bytes(path, "text_bytes").decode("utf-8-sig", errors)


def parse_json(text: str | bytes, path: str | Path, cure: str = "export it again") -> Any:
    """What JSON says; numbers that are not finite, which it does not know, are refused. Raises InputError."""

    def no_number(name: str) -> Any:
        raise InputError(f"{shown(path)}: not readable as JSON (it holds {name}); {cure}")

    with readable(path, "JSON", cure):
        return json.loads(text, parse_constant=no_number)


def read_json(path: Path, cure: str) -> Any:
    """What a JSON file holds. Raises InputError, with the ``cure``, for one that is missing or broken."""
    if not is_file(path):
        raise InputError(f"{shown(path)}: missing; {cure}")
    return parse_json(read_text(path, cure), path, cure)


def read_record(kind: type[T], path: Path, cure: str) -> T:
    """A dataclass from a JSON file, as ``decode`` reads it; fields that it does not know are passed over. Raises
    InputError."""
    return decoded(kind, read_json(path, cure), path, cure)


def sealed(record: dict[str, Any]) -> dict[str, Any]:
    """A record of JSON's own kinds of values, with its checksum."""
    return {**record, CHECKSUM: _digest(record)}


def read_sealed(path: Path, cure: str) -> Any:
    """What was ``sealed`` and kept as JSON, without its checksum; earlier files have none. Raises InputError."""
    record = read_json(path, cure)
    if not isinstance(record, dict) or CHECKSUM not in record:
        return record
    content = {name: value for name, value in record.items() if name != CHECKSUM}
    check_seal(record[CHECKSUM], _digest(content), path, cure)
    return content


def check_seal(told: Any, found: str, path: Path, cure: str) -> None:
    """Raises InputError where a file's content does not give the checksum that it tells."""
    if told != found:
        raise InputError(f"{path}: is damaged (its content does not give its checksum); {cure}")


def _digest(record: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


def decoded(kind: type[T], value: Any, path: str | Path, cure: str) -> T:
    """A dataclass from a table that stands in the file ``path``; fields that it does not know are passed over."""
    known = {field.name for field in fields(cast(Any, kind))}
    if isinstance(value, dict):
        value = {name: each for name, each in value.items() if name in known}
    try:
        return decode(kind, value)
    except ValueError as error:
        raise InputError(f"{shown(path)}: {str(error).removeprefix(': ')}; {cure}") from error


def read_toml(path: Path, cure: str) -> dict[str, Any]:
    """What a TOML file holds. Raises InputError."""
    text = read_text(path, cure)
    with readable(path, "TOML", cure):
        return tomllib.loads(text)


def read_arrays(path: Path, kind: str, cure: str = "export it again") -> np.ndarray | dict[str, np.ndarray]:
    """The array of an NPY file, or all of an NPZ by name; none of objects. Raises InputError."""
    with readable(path, kind, cure):
        check_file(path)
        if zipfile.is_zipfile(path):
            return _unpacked(path, path.stat().st_size, path)
        with path.open("rb") as file:
            return _one_array(file, path.stat().st_size)


def map_array(path: Path) -> np.ndarray:
    """The array of an NPY file, which is read from disk where it is looked at. Raises InputError."""
    with readable(existing(path, "an array"), "NPY"), path.open("rb") as file:
        _check_head(file, path.stat().st_size, within_limits=False)
        return np.load(path, mmap_mode="r", allow_pickle=False)


def array_shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Of the array of an NPY file, which has no name, or those of an NPZ by name; of the files only the heads are read.
    Raises InputError."""
    with readable(existing(path, "an array"), "arrays"):
        if not zipfile.is_zipfile(path):
            with path.open("rb") as file:
                return {"": _check_head(file, path.stat().st_size)}
        found = {}
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                with archive.open(member) as file:
                    found[member.filename.removesuffix(".npy")] = _check_head(file, member.file_size)
        return found


def parse_arrays(stored: bytes, name: str) -> np.ndarray | dict[str, np.ndarray]:
    """What ``read_arrays`` reads, of a file's bytes. Raises InputError."""
    with readable(name, "an array"):
        file, is_zip = io.BytesIO(stored), zipfile.is_zipfile(io.BytesIO(stored))
        return _unpacked(file, len(stored), name, "sent_bytes") if is_zip else _one_array(file, len(stored))


def _unpacked(file: Any, size: int, name: str | Path, most: str = "data_bytes") -> dict[str, np.ndarray]:
    check_limit("data_bytes", size, f"{name}: the file")
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        check_limit(most, sum(member.file_size for member in members), f"{name}: what it unpacks to")
        found = {}
        for member in members:
            with archive.open(member) as inside:
                found[member.filename.removesuffix(".npy")] = _one_array(inside, member.file_size)
        return found


def _one_array(file: Any, size: int) -> np.ndarray:
    """Of a file of ``size`` bytes; its head is read first, since it may claim more than there is."""
    _check_head(file, size)
    file.seek(0)
    return npy.read_array(file, allow_pickle=False)


def _check_head(file: Any, size: int, within_limits: bool = True) -> tuple[int, ...]:
    """The shape of an array of numbers in a file of ``size`` bytes."""
    version = npy.read_magic(file)
    shape, _, dtype = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(file)
    if dtype.hasobject or dtype.kind == "V":
        raise ValueError(f"dtype {dtype} is not of numbers")
    claimed = math.prod(shape) * dtype.itemsize
    if not 0 <= claimed <= size:
        raise ValueError("it is cut short")
    if within_limits:
        check_limit("data_bytes", claimed, "the array")
    return shape


def read_image(
    source: Path | bytes, name: str | Path, mode: str | None = None, cure: str = "export it again"
) -> np.ndarray:
    """An image file, or its bytes, as it is stored, (H, W) or (H, W, channels); with ``mode``, palettes, alpha
    and colours for printers become that mode. ``name``: of it in messages. Raises InputError for what is
    not readable as one."""
    from PIL import Image

    if Image.MAX_IMAGE_PIXELS is not None:  # where a user may read larger ones, Pillow is not to refuse them
        Image.MAX_IMAGE_PIXELS = max(Image.MAX_IMAGE_PIXELS, limits().image_pixels)
    with readable(name, "an image", cure):
        if isinstance(source, Path):
            check_file(source)
        opened = io.BytesIO(source) if isinstance(source, bytes) else source
        try:
            image = Image.open(opened, formats=IMAGE_FORMATS)
        except Image.DecompressionBombError:  # Pillow's own limit, where it is far beyond ours
            check_limit("image_pixels", 2 * (Image.MAX_IMAGE_PIXELS or 0), f"{name}: the image")
            raise
        with image:
            check_limit("image_pixels", image.width * image.height, f"{name}: the image")
            check_limit("image_side", max(image.size), f"{name}: the image")
            converted = mode and image.mode in ("P", "RGBA", "LA", "CMYK", "YCbCr")
            return np.asarray(image.convert(mode) if converted else image)
