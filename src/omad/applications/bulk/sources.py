"""Where many depth images come from: folders, stacks in one array, Parquet files; read as they are needed."""

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import address_of, is_file, map_array, read_arrays
from omad.data.shards.store import Store
from omad.sensing.beside import is_companion, may_lie_beside
from omad.sensing.depth_files import called, in_metres
from omad.sensing.input_options import FrameOptions, InputOptions
from omad.sensing.observation import Observation
from omad.sensing.reader import KNOWN, InputReader, check_masks_apart, tells_camera

from .parquet_images import SUFFIX, ParquetImages
from .stream import Frame

_LISTED = (*KNOWN, SUFFIX)
CLOUD = "points"
"""What a cloud in an NPZ is called."""


@dataclass(frozen=True)
class Source:
    """Frames in a fixed order, of which any may be the first."""

    total: int
    after: Callable[[int], Iterator[Frame]]
    """Its frames without the first so many, which are not read."""
    fingerprint: Callable[[], str] = str
    """Of the files that its frames are made of, cameras and masks among them: with others, rows are of others. It asks
    the disk for each of them."""


def open_sources(
    inputs: Sequence[Path], reading: InputOptions | None = None, frame: FrameOptions | None = None
) -> Source:
    """All of ``inputs``, one after the other. Each is

    - a folder: its Parquet files, then its depth images and clouds, by name; where it has none, those of its
      sub-folders;
    - a stack: NPY (N, H, W), of which only the images at work are in memory, or NPZ with ``depth`` (N, H, W) and, if it
      has one, ``mask`` (N, H, W); with ``--mask`` an NPY of the same shape;
    - a Parquet file (``parquet_images.py`` says with which columns);
    - the address of a Parquet file, or of a folder of them, that fsspec knows (``s3://...``);
    - one depth image or cloud.

    Names are those of files, with ``[index]`` for an image in a stack, or what a Parquet file's ``id`` says.
    Raises InputError for what cannot be read at all; a bad frame raises when it is loaded."""
    reading, frame = reading or InputOptions(), frame or FrameOptions()
    if not inputs:
        raise InputError("no input; give a folder of depth images, a stack (.npy, .npz) or a Parquet file")
    addresses = {path: address for path in inputs if (address := address_of(path)) is not None}
    if missing := [path for path in inputs if path not in addresses and not path.exists()]:
        raise InputError(f"{missing[0]}: no such file or folder; give depth images, a stack or a Parquet file")
    masks = None if reading.mask is None else _stack_in(reading.mask, "mask")
    alone = reading if masks is None else replace(reading, mask=None)
    local = [path for path in inputs if path not in addresses]
    groups = {path: _listed(path) if path.is_dir() else _Group(path.parent, [path.name]) for path in local}

    def images() -> Iterator[Path]:
        return (file for group in groups.values() for file in group.files() if file.suffix.lower() != SUFFIX)

    first = next(images(), None)
    if reading.intrinsics is None:  # an image without them is refused alone, where others have theirs
        first = next(filter(tells_camera, images()), first)
    reader = InputReader.of(alone, [] if first is None else [first], frame)
    if isinstance(reader.mask, Path):
        check_masks_apart(images(), reader.mask)
    sources, remote = list[Source](), list[str]()
    for path in inputs:
        if path in addresses:
            remote += (found := _at(addresses[path]))
            sources += [_parquet(file, reader) for file in found]
            continue
        group = groups[path]
        stack = None if path.is_dir() else _stack_in(path, "depth")
        if stack is not None:
            sources.append(_stack(path, stack, _stack_in(path, "mask", named=True) if masks is None else masks, reader))
            continue
        if masks is not None:
            raise InputError(f"--mask {reading.mask}: is a stack, but {path} none; give a mask or a folder of them")
        sources += [_parquet(file, reader) for file in group.files() if file.suffix.lower() == SUFFIX]
        single = [name for name in group.names if Path(name).suffix.lower() != SUFFIX]
        sources.append(_single(_Group(group.folder, single), reader))
    if not any(source.total for source in sources):
        raise InputError(f"{inputs[0]}: holds no image; give a file with rows")
    told = (reading.mask, reading.intrinsics, frame.color_intrinsics, frame.color_extrinsics)
    named = [Path(each) for each in told if each is not None]
    return _chained(sources, partial(_fingerprint, [*groups.values()], named, remote))


def _fingerprint(groups: Sequence["_Group"], named: Sequence[Path], remote: Sequence[str]) -> str:
    """Of names, sizes and times of writing: of the files of ``groups`` and what may lie beside each, of those that the
    options ``named``, of all that is in a folder of masks, and of ``remote`` files by their addresses."""
    digest = hashlib.sha256()

    def add(name: str, files: Iterable[Path]) -> None:
        digest.update(os.fsencode(name))
        for file in filter(is_file, files):
            with suppress(OSError):  # taken away in this moment
                status = file.stat()  # times to the second, as some file systems keep them
                digest.update(os.fsencode(file.name) + f"\0{status.st_size} {int(status.st_mtime)}\0".encode())

    for group in groups:
        for name, file in zip(group.names, group.files(), strict=True):
            add(name, [file, *may_lie_beside(file)])
    for path in named:
        add(path.name, sorted(path.rglob("*")) if path.is_dir() else [path])
    for address in remote:
        folder, name = address.rsplit("/", 1)
        with suppress(OSError):
            digest.update(f"{name}\0{Store.of(folder).stamp(name)}\0".encode())
    return digest.hexdigest()


@dataclass(frozen=True)
class _Group:
    """Files of one folder: by their names alone, as there may be a million."""

    folder: Path
    names: list[str]

    def files(self) -> Iterator[Path]:
        return (self.folder / name for name in self.names)


def _listed(folder: Path) -> _Group:
    """Files of a folder; where it has none, of its sub-folders, as ``omad render`` writes an object into each."""
    names = _names(folder)
    if not names:
        with _entries(folder) as entries:
            within = sorted(entry.name for entry in entries if entry.name[0] != "." and entry.is_dir())
        names = [f"{inner}/{name}" for inner in within for name in _names(folder / inner)]
    if not names:
        raise InputError(f"{folder}: no depth image, cloud or Parquet file in it; known: {' '.join(_LISTED)}")
    return _Group(folder, names)


def _names(folder: Path) -> list[str]:
    """A link whose file is missing is one of them: it is refused in its place, not passed over."""
    with _entries(folder) as entries:
        listed = (e for e in entries if e.name[0] != "." and e.name.lower().endswith(_LISTED))
        return sorted(e.name for e in listed if not is_companion(Path(e.name)) and not e.is_dir())


@contextmanager
def _entries(folder: Path) -> Iterator[Iterator[os.DirEntry[str]]]:
    try:
        with os.scandir(folder) as entries:
            yield entries
    except OSError as error:
        raise InputError(f"{folder}: cannot be listed ({error.strerror}); make it readable, or leave it out") from error


def _text(path: Path | str) -> str:
    """A path as UTF-8, which results are; on Linux a name may hold any bytes."""
    return os.fsencode(path).decode(errors="backslashreplace")


def _at(address: str) -> list[str]:
    """Addresses of the Parquet files at one."""
    if address.lower().endswith(SUFFIX):
        return [address]
    names = sorted(name for name in Store.of(address).names() if name.lower().endswith(SUFFIX))
    if not names:
        raise InputError(f"{address}: no Parquet file there; give a Parquet file of depth images, or a folder of them")
    return [f"{address.rstrip('/')}/{name}" for name in names]


def _single(group: _Group, reader: InputReader) -> Source:
    def after(done: int) -> Iterator[Frame]:
        return (Frame(_text(file), partial(reader, file)) for file in islice(group.files(), done, None))

    return Source(len(group.names), after)


def _stack_in(path: Path, key: str, named: bool = False) -> np.ndarray | None:
    """Images (N, H, W) of an NPY, on disk, or those called ``key`` of an NPZ, or its only ones; None where a file is no
    stack. ``named``: what an NPZ calls so, of whatever shape. Raises InputError for stacks of which none is meant."""
    meant = True
    try:
        if path.suffix.lower() == ".npz":
            stored = read_arrays(path, "a stack of images")
            if named:
                return stored.get(key) if isinstance(stored, dict) else None
            stacks = isinstance(stored, dict) and any(array.ndim == 3 for array in stored.values())
            meant = not stacks or CLOUD in stored
            found = called(stored, key, path)
        elif path.suffix.lower() == ".npy" and not named:
            found = map_array(path)
        else:
            return None
    except InputError:
        if not meant:
            raise
        return None  # whoever reads it as a single image says what is wrong
    # (H, W, 3) is an organised cloud, (H, W, 1) one image
    return found if found is not None and found.ndim == 3 and found.shape[-1] not in (1, 3) else None


def _stack(path: Path, depths: np.ndarray, masks: np.ndarray | None, reader: InputReader) -> Source:
    if masks is not None and masks.shape != depths.shape:
        raise InputError(f"{path}: its shape is {depths.shape}, that of its masks {masks.shape}; give one for each")
    if not len(depths):
        raise InputError(f"{path}: holds no image; give a stack (N, H, W) of depth images")
    if isinstance(reader.mask, Path):
        raise InputError(f"--mask {reader.mask}: is a folder, but {path} a stack; give a stack of masks (N, H, W)")
    if masks is None:
        reader.check_mask_id()

    def load(index: int) -> Observation:
        mask = reader.mask if masks is None else np.asarray(masks[index])
        assert not isinstance(mask, Path)
        depth = in_metres(np.asarray(depths[index]), reader.depth_scale, reader.metres_per_integer())
        return reader.observe(depth, mask)

    def after(done: int) -> Iterator[Frame]:
        return (Frame(f"{_text(path)}[{index}]", partial(load, index)) for index in range(done, len(depths)))

    return Source(len(depths), after)


def _parquet(path: Path | str, reader: InputReader) -> Source:
    images = ParquetImages.open(path, reader)
    return Source(images.total, images.after)


def _chained(sources: Sequence[Source], fingerprint: Callable[[], str]) -> Source:
    def after(done: int) -> Iterator[Frame]:
        for source in sources:
            if done < source.total:
                yield from source.after(done)
            done = max(done - source.total, 0)

    return Source(sum(source.total for source in sources), after, fingerprint)
