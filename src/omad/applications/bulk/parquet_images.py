"""Depth images in a Parquet file, a row each. Columns:

- ``depth``: the bytes of a PNG, TIFF or NPY file (also as Hugging Face's struct of ``bytes`` and ``path``); or with the
  columns ``height`` and ``width`` the pixels row by row, as numbers or as little-endian bytes of uint16, float32 or
  float64; or a list of rows of numbers. Integers are millimetres, floats metres, if nothing else is said.
- ``mask``, if there is one: in the same forms, as ``read_mask`` takes them, or a byte a pixel; of rows without one the
  mask given for all holds; where there is none and ``mask_id`` says which object, such a row is refused.
- ``depth_scale``, if it is not the usual one: metres per number; else that of ``intrinsics``, or of a PNG's text.
- ``intrinsics``, if they are not the same for all: fx, fy, cx, cy, nine numbers row by row, or a camera file's text.
- ``id``, if rows have names.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, Self

import numpy as np

from omad.common.errors import InputError, WorkError, shown
from omad.common.files import one_line
from omad.data.shards.parquet import import_pyarrow
from omad.data.shards.store import Store
from omad.sensing.beside import scale_in_text
from omad.sensing.camera_files import CameraFile, parse_camera
from omad.sensing.depth_files import in_metres, parse_mask, parse_stored
from omad.sensing.observation import Observation
from omad.sensing.reader import NEED_INTRINSICS, InputReader

from .stream import Frame

SUFFIX = ".parquet"
COLUMNS = ("id", "depth", "mask", "depth_scale", "intrinsics", "height", "width")
ROWS = 16
"""Read together."""
RAW = {1: "u1", 2: "<u2", 4: "<f4", 8: "<f8"}
"""Stored numbers by their bytes."""


@dataclass(frozen=True)
class ParquetImages:
    """An open file."""

    path: Path | str
    """Or its address."""
    file: Any
    """pyarrow.parquet.ParquetFile."""
    reader: InputReader
    columns: list[str]

    @classmethod
    def open(cls, path: Path | str, reader: InputReader) -> Self:
        """Of a path, or of an address that fsspec knows. Raises InputError for a file that is no Parquet, or that has
        no depth or no intrinsics."""
        if isinstance(path, Path) and not path.is_file():
            raise InputError(f"{path}: no such file; give a Parquet file of depth images")
        parquet = import_pyarrow().parquet
        try:
            file = parquet.ParquetFile(path if isinstance(path, Path) else _opened(path))
        except Exception as error:
            _check_reached(path, error)
            raise InputError(f"{path}: not readable as Parquet ({one_line(error)}); export it again") from error
        found = file.schema_arrow.names
        if "depth" not in found:
            raise InputError(f"{path}: no column depth, only {', '.join(found)}; rename the one with depth images")
        if "intrinsics" not in found and reader.camera is None:
            raise InputError(f"{path}: {NEED_INTRINSICS}, or a column intrinsics")
        if "mask" not in found:
            reader.check_mask_id()
        if "mask" not in found and isinstance(reader.mask, Path):
            raise InputError(f"--mask {reader.mask}: is a folder; give {path} a column mask")
        return cls(path, file, reader, [name for name in COLUMNS if name in found])

    @property
    def total(self) -> int:
        """Rows."""
        return self.file.metadata.num_rows

    def after(self, done: int) -> Iterator[Frame]:
        """The frames after the first ``done``; groups of rows that lie before them are not read."""
        first, start = 0, 0
        sizes = [self.file.metadata.row_group(group).num_rows for group in range(self.file.num_row_groups)]
        while first < len(sizes) and start + sizes[first] <= done:
            start += sizes[first]
            first += 1
        groups = list(range(first, len(sizes)))
        try:
            for batch in self.file.iter_batches(ROWS, groups, self.columns) if groups else ():
                for row in range(max(done - start, 0), batch.num_rows):
                    values = {name: batch.column(name)[row] for name in self.columns}
                    name = values["id"].as_py() if "id" in values else None
                    yield Frame(
                        f"{self.path}[{start + row}]" if name is None else str(name), partial(self._load, values)
                    )
                start += batch.num_rows
        except OSError as error:
            _check_reached(self.path, error)
            raise InputError(f"{self.path}: damaged ({one_line(error)}); copy it anew") from error

    def _load(self, values: dict[str, Any]) -> Observation:
        sides = [_number(values, name, whole=True) for name in ("height", "width")]
        shape = None if None in sides else (int(sides[0] or 0), int(sides[1] or 0))
        depth = _image(values["depth"], shape, "depth", partial(parse_stored, key="depth", name="image"))
        if depth is None:
            raise InputError("depth: is null; leave the row out")
        parse = partial(parse_mask, name="image", mask_id=self.reader.mask_id)
        mask = _image(values["mask"], shape, "mask", parse) if "mask" in values else None
        if mask is None:
            assert not isinstance(self.reader.mask, Path)  # ``open`` refuses it
            mask = self.reader.mask
        if mask is None and (number := self.reader.mask_id) is not None:
            cure = "give the row a mask, or --mask for rows without, or leave the row or --mask-id out"
            raise InputError(f"mask: is null, and --mask-id {number} tells one of its objects; {cure}")
        told = values["intrinsics"].as_py() if "intrinsics" in values else None
        camera = None if told is None else _camera(told)
        scale = _number(values, "depth_scale")
        scale = self.reader.depth_scale if scale is None else scale
        own = None if camera is None else camera.depth_scale
        usual = own or self.reader.metres_per_integer(_scale_in_text(values["depth"]))
        return self.reader.observe(in_metres(depth, scale, usual), mask, camera)


def _check_reached(path: Path | str, error: Exception) -> None:
    """Raises WorkError for what may go well the next time: a disk elsewhere or a network did not answer."""
    if not isinstance(path, Path) and isinstance(error, OSError) and not isinstance(error, FileNotFoundError):
        raise WorkError(f"{path}: cannot be read ({one_line(error)}); run it again") from error


def _opened(address: str) -> Any:
    folder, _, name = address.rpartition("/")
    return Store.of(folder).open(name)


def _camera(told: Any) -> CameraFile:
    numbers = told if isinstance(told, str) else ",".join(map(str, np.asarray(told, dtype=float).ravel()))
    return parse_camera(numbers, "intrinsics")


def _scale_in_text(value: Any) -> float | None:
    """That of a PNG, of an Arrow scalar."""
    value = value["bytes"] if hasattr(value, "keys") else value
    return None if hasattr(value, "values") else scale_in_text(BytesIO(value.as_py()), "depth")


def _number(values: dict[str, Any], name: str, whole: bool = False) -> float | None:
    """Of a row; None where it has none, which pandas writes as NaN. Raises InputError."""
    told = values[name].as_py() if name in values else None
    if told is None or told != told:
        return None
    if not isinstance(told, int | float) or not 0 < told < np.inf or (whole and told != int(told)):
        kind = "whole numbers from 1" if whole else "numbers above 0"
        raise InputError(f"{name}: is {shown(repr(told))}; give {kind}, or null")
    return told


def _image(
    value: Any, shape: tuple[int, int] | None, name: str, parse: Callable[[bytes], np.ndarray]
) -> np.ndarray | None:
    """(H, W) of an Arrow scalar; None for null. ``parse`` reads a file's bytes. Raises InputError."""
    if hasattr(value, "keys"):  # a struct
        if "bytes" not in value:
            raise InputError(f"{name}: its struct has no field bytes; store the image file's bytes there")
        value = value["bytes"]
    if not value.is_valid:
        return None
    try:
        if hasattr(value, "values"):  # a list
            numbers = value.values
            if hasattr(numbers, "flatten"):  # of rows
                if numbers.null_count or len({len(row) for row in numbers}) > 1:
                    raise ValueError("its rows are not of one length")
                shape, numbers = (len(numbers), -1), numbers.flatten()
            array = numbers.to_numpy(zero_copy_only=False)
        else:
            stored = value.as_py()
            each, rest = (0, 0) if shape is None else divmod(len(stored), shape[0] * shape[1])
            if rest or each not in RAW:  # a file's, of an image whose size other columns may tell, too
                return parse(stored)
            array = np.frombuffer(stored, RAW[each])
        if shape is None:
            raise ValueError("columns height and width are needed for a flat list")
        return array.reshape(shape)
    except Exception as error:  # readers of images raise anything
        cure = "give an image file's bytes, or height, width and all pixels"
        raise InputError(f"{name}: not readable as an image ({one_line(error)}); {cure}") from error
