"""Good files made bad: bytes at random, values of each kind of file, and things that are no file at all."""

import io
import json
import os
import re
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from omad.common.incoming import CHECKSUM

ODD: list[Any] = [
    None,
    True,
    0,
    -1,
    1,
    7,
    2**31,
    10**30,
    10**400,
    -0.0,
    0.5,
    1e-300,
    1e30,
    1e300,
    float("nan"),
    float("inf"),
    "",
    "x",
    "a\0b",
    "../../../etc/passwd",
    "/etc/passwd",
    "$x$",
    "\\frac{1",
    "\ud800",
    "x" * 5000,
    [],
    [[]],
    [1, 2],
    [[1, 2], [3]],
    {},
    {"a": 1},
    [None],
    ["x"],
    [1e300] * 3,
]
"""In place of a value."""
WORDS = [b"\0", b"nan", b"inf", b"1e999", b"-1", b"9" * 20, b"\xff\xfe", b"[" * 2000, b"<a>" * 300, b"&a;", b"$"]
"""Into a file of any kind."""
TOKENS = [
    "nan",
    "inf",
    "-inf",
    "1e300",
    "-1",
    "0",
    "0 0 0",
    "1e-300",
    "9" * 400,
    "x",
    "",
    "true",
    "1979-05-27",
    "[]",
    "{}",
    "../../../etc/passwd",
    "/dev/zero",
    "/etc",
    "a\0b",
    "\u202e",
    "x" * 5000,
    "$x$",
    "package://x/y.obj",
    "1,2",
    "[" * 5000,
]
"""In place of a word of a text."""
BOMB = (
    '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True))
    + ']><robot name="&j;">'
)
ALIASES = "a: &a [1]\n" + "".join(
    f"{b}: &{b} [{f'*{a},' * 9}*{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
TEXTS = (".toml", ".yaml", ".urdf", ".csv", ".xyz", ".txt", ".obj", ".mtl", ".jsonl", ".part")
IMAGES = (".png", ".tif", ".jpg")


def spoil(content: bytes, name: str, rng: np.random.Generator) -> bytes:
    """The same but for something, mostly as only that kind of file can be wrong; ``name`` tells the kind."""
    suffix = Path(name).suffix
    kind = _JSON if suffix in (".json", ".run") else _KINDS.get(suffix)
    if kind is not None and rng.random() < 0.8:
        return kind(content, rng)
    return any_bytes(content, rng)


def any_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Cut, doubled, something put in, or bits turned."""
    data, kind = bytearray(content), rng.integers(6)
    start, end = sorted(rng.integers(0, len(data) + 1, 2).tolist())
    if kind == 0:
        return bytes(data[:start])
    if kind == 1:
        return bytes(data[:start] + data[end:])
    if kind == 2:
        return bytes(data[:start] + WORDS[rng.integers(len(WORDS))] + data[start:])
    if kind == 3:
        return bytes(data[:end] + data[start:end] + data[end:])
    for place in rng.integers(0, max(len(data), 1), rng.integers(1, 8)):
        if len(data):
            data[place] ^= 1 << int(rng.integers(8))
    return bytes(data)


def no_file(path: Path, rng: np.random.Generator) -> None:
    """Something else at ``path``: nothing, a folder, a pipe that nobody writes to, links that lead nowhere or round and
    round, or to endless devices."""
    path.unlink()
    make: list[Callable[[], Any]] = [
        lambda: None,
        path.mkdir,
        lambda: os.mkfifo(path),
        lambda: path.symlink_to(path.name),
        lambda: path.write_bytes(b""),
        lambda: path.symlink_to("/dev/zero"),
        lambda: path.symlink_to("/nowhere"),
        lambda: path.symlink_to(path.parent),
    ]
    make[rng.integers(len(make))]()


def odd_value(value: Any, rng: np.random.Generator) -> Any:
    """JSON with one value at any depth replaced, or gone."""
    inner = list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    if not inner or rng.random() < 0.1:
        return ODD[rng.integers(len(ODD))]
    key = inner[rng.integers(len(inner))]
    if rng.random() < 0.1:
        return (
            {k: v for k, v in value.items() if k != key} if isinstance(value, dict) else value[:key] + value[key + 1 :]
        )
    changed = value.copy()
    changed[key] = odd_value(value[key], rng)
    return changed


def _JSON(content: bytes, rng: np.random.Generator) -> bytes:
    value = json.loads(content)
    if isinstance(value, dict):
        value.pop(CHECKSUM, None)  # which would refuse all else
    text = json.dumps(odd_value(value, rng))
    if rng.random() < 0.05:
        return text.replace(":", ": " + "[" * 20_000, 1).encode()
    if rng.random() < 0.05:  # names that are there twice
        return (text.rstrip("}") + "," + text.lstrip("{")).encode()
    return text.encode()


def _text(content: bytes, rng: np.random.Generator) -> bytes:
    """A word replaced by an odd one, or by another of the same text: names that are there twice, parents of
    themselves, counts that lie."""
    text = content.decode("utf-8", "replace")
    if rng.random() < 0.03:
        return (BOMB + text.partition(">")[2] if "<robot" in text else ALIASES + text).encode()
    words = [found.span() for found in re.finditer(r"[\w.+-]+|\"[^\"]*\"", text)]
    if not words:
        return any_bytes(content, rng)
    start, end = words[rng.integers(len(words))]
    other = text[slice(*words[rng.integers(len(words))])]
    new = other if rng.random() < 0.5 else str(rng.choice(TOKENS))
    if text[start] == '"' and not new.startswith('"'):
        new = f'"{new}"'
    return (text[:start] + new + text[end:]).encode("utf-8", "replace")


def odd_array(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Of another kind, shape, order, or with values that mean nothing."""
    number, kind = float(rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e30, -1.0, 0.0, 65535.0])), rng.integers(16)
    flat = array.ravel()
    kinds = ["c16", "U3", "S2", "?", "f2", "g", ">f4", "M8[s]", "i8", "u1", ">u2"]
    with np.errstate(all="ignore"):
        if kind < 4:
            return array.astype(kinds[rng.integers(len(kinds))])
        if kind == 4:
            return np.zeros(array.shape, [("a", "f4"), ("b", "i4")])
        if kind == 5:
            return np.asfortranarray(array)
        if kind == 6:
            shapes = [(0,), (0, 7), (7, 0), (), (1,), (1, 1), (3,), (1, 1, 1, 1), (2, 3, 4), (5, 1), (1, 5)]
            return np.resize(array, shapes[rng.integers(len(shapes))])
        if kind == 7:
            return array[::-1] if array.ndim else array
        if kind == 8:
            return array.T
        if kind == 9:
            return array[..., None]
        if kind == 10 and array.ndim:
            return array[: len(array) // 2]
        found = array.astype(np.float64) if kind < 14 and array.dtype.kind in "iub" else array.copy()
        if found.dtype.kind not in "iufb" or not flat.size:
            return np.array(["x"])
        where = rng.random(found.shape) < float(rng.choice([0.001, 0.1, 1.0]))
        return np.where(where, np.nan_to_num(number) if found.dtype.kind != "f" else number, found).astype(found.dtype)


def _npy(content: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.2:  # a head that claims more than there is
        return content.replace(b"'shape': (", b"'shape': (%d, " % 10 ** rng.integers(1, 19), 1)
    if rng.random() < 0.1:
        return _stored(np.array([{"a": print}, None], dtype=object))
    return _stored(odd_array(np.load(io.BytesIO(content)), rng))


def _stored(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def _npz(content: bytes, rng: np.random.Generator) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = str(rng.choice(list(members)))
    kind, written = rng.integers(12), io.BytesIO()
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[name] = b"no array"
    elif kind == 2:
        members["../../evil.npy"] = members[name]
    elif kind == 3:
        members[name.removesuffix(".npy") + "2.npy"] = members.pop(name)
    else:
        members[name] = _npy(members[name], rng)
    with zipfile.ZipFile(written, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, stored in members.items():
            archive.writestr(each, stored)
        if kind == 4:
            archive.writestr(name, members[name])  # twice
    return written.getvalue() if kind != 5 else _zip_bomb(name)


@cache
def _zip_bomb(name: str) -> bytes:
    """An array of more than is taken, in little."""
    head = _stored(np.zeros(0, np.uint8)).replace(b"(0,)", b"(%d,)" % (52 * 10**7))
    written, block = io.BytesIO(), bytes(10**7)
    with (
        zipfile.ZipFile(written, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(name, "w", force_zip64=True) as file,
    ):
        file.write(head)
        for _ in range(52):
            file.write(block)
    return written.getvalue()


def _image(content: bytes, rng: np.random.Generator) -> bytes:
    """Another format, mode or size under the same name."""
    image, written, kind = Image.open(io.BytesIO(content)), io.BytesIO(), rng.integers(10)
    if kind == 0:
        return b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(/tmp/omad-fuzz-evil) (w) file closefile\n"
    if kind == 1:
        return _huge_png(*((100_000, 100_000), (1, 10**9), (2**31 - 1, 1), (0, 7))[rng.integers(4)])
    if kind == 2:
        sizes = [(1, 1), (1, 40), (60, 1), (2, 2), image.size[::-1]]
        image = image.resize(sizes[rng.integers(len(sizes))])
    elif kind < 6:
        modes = ["1", "L", "LA", "P", "RGB", "RGBA", "I", "F", "CMYK", "YCbCr", "HSV", "I;16", "I;16B"]
        try:
            image = image.convert(modes[rng.integers(len(modes))])
        except ValueError:
            image = image.convert("I").convert("L")
    frames = {"save_all": True, "append_images": [image] * 3} if kind == 6 else {}
    formats = ["PNG", "TIFF", "WEBP", "GIF", "BMP", "JPEG", "PPM", "ICO", "TGA", "PDF", "JPEG2000"]
    try:
        image.save(written, formats[rng.integers(len(formats))], **frames)
    except (OSError, ValueError, KeyError):
        image.convert("L").save(written, "TIFF")
    return written.getvalue()


def _huge_png(width: int, height: int) -> bytes:
    """A few bytes that say they are a large image."""
    chunks = [(b"IHDR", np.array([width, height], ">u4").tobytes() + bytes([16, 0, 0, 0, 0]))]
    chunks += [(b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")]
    parts = (
        np.array([len(d)], ">u4").tobytes() + n + d + np.array([zlib.crc32(n + d)], ">u4").tobytes() for n, d in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _tensors(content: bytes, rng: np.random.Generator) -> bytes:
    """Weights whose head says something else, or whose numbers mean nothing; without a checksum that would say so."""
    size = int(np.frombuffer(content[:8], "<u8")[0])
    head, data = json.loads(content[8 : 8 + size]), bytearray(content[8 + size :])
    head.pop("__metadata__", None)
    if rng.random() < 0.3:
        head = odd_value(head, rng)
    else:
        about = head[str(rng.choice(list(head)))]
        start, end = about["data_offsets"]
        kind = {"F32": np.float32, "F16": np.float16, "F64": np.float64}.get(about["dtype"], np.uint8)
        with np.errstate(all="ignore"):
            values = odd_array(np.frombuffer(data[start:end], kind), rng)
            data[start:end] = np.resize(values.astype(kind), len(data[start:end]) // np.dtype(kind).itemsize).tobytes()
    text = json.dumps(head).encode()
    return np.array([len(text)], "<u8").tobytes() + text + bytes(data)


def _parquet(content: bytes, rng: np.random.Generator) -> bytes:
    import pyarrow
    import pyarrow.parquet

    rows = pyarrow.parquet.read_table(io.BytesIO(content)).to_pydict()
    name = str(rng.choice(list(rows)))
    if rng.random() < 0.15:
        del rows[name]
    else:
        odd = [b"", b"x", "x", 1, -1, 1e300, float("nan"), None, [1, 2], [[1.0], [2.0]], {"bytes": b"x"}, True, 2**62]
        value = odd[rng.integers(len(odd))]
        rows[name] = [value] * len(rows[name])
    table, written = pyarrow.table(rows), io.BytesIO()
    pyarrow.parquet.write_table(table, written)
    return written.getvalue()


_KINDS = dict.fromkeys(TEXTS, _text) | dict.fromkeys(IMAGES, _image)
_KINDS |= {".npy": _npy, ".npz": _npz, ".safetensors": _tensors, ".parquet": _parquet}
