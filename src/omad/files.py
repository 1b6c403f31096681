"""Reading depth images, clouds and masks as people have them; writing files that are whole or not there."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image, UnidentifiedImageError

from .errors import InputError

DEPTH_FORMATS = (".png", ".tif", ".tiff", ".npy", ".npz")
CLOUD_FORMATS = (".ply", ".pcd", ".xyz", ".txt", ".npy", ".npz")
MILLIMETRES = 1e-3
"""Metres per stored integer of a depth image that does not say otherwise."""


def write_atomic(path: str | Path, write: Callable[[Path], Any]) -> None:
    """Call ``write`` with a temporary path beside ``path``, then rename it: a crash leaves no half-written file.

    The temporary name ends in the same extension. Raises InputError where the folder cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another folder") from error
    temporary = Path(name)
    try:
        os.close(handle)
        write(temporary)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp, and some writers, make files that only their owner may read
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another folder") from error
    finally:
        temporary.unlink(missing_ok=True)


def make_folder(path: str | Path) -> None:
    """Create a folder and those above it. Raises InputError where that cannot be."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be a folder for output ({error.strerror}); choose another one") from error


def read_depth(path: str | Path, depth_scale: float | None = None) -> np.ndarray:
    """Depth image (H, W) float32 in metres; 0 and what is not finite mean no measurement.

    16-bit PNG or TIFF, or an integer array: stored integers times ``depth_scale`` metres, by default millimetres.
    A float array (NPY, NPZ with one array or one named ``depth``): metres, times ``depth_scale`` if given.
    Raises InputError for a missing, unreadable or 8-bit file and for a wrong shape.
    """
    path = _existing(path, DEPTH_FORMATS, "depth image")
    if depth_scale is not None and not (np.isfinite(depth_scale) and depth_scale > 0):
        raise InputError(f"depth scale {depth_scale}: give metres per stored integer, 0.001 for millimetres")
    stored = read_array(path, "depth") if path.suffix.lower() in (".npy", ".npz") else read_image(path)
    if stored.ndim == 3 and stored.shape[2] == 1:
        stored = stored[..., 0]
    if stored.ndim != 2 or stored.dtype == np.uint8:
        raise InputError(
            f"{path}: {stored.dtype} of shape {stored.shape} is no depth image (8-bit or colour images hold too"
            " few depth steps); export 16-bit single-channel depth"
        )
    if stored.dtype.kind not in "iuf":
        raise InputError(f"{path}: dtype {stored.dtype} is no depth; store integers or floats")
    if depth_scale is None:
        depth_scale = 1.0 if stored.dtype.kind == "f" else MILLIMETRES
    return (stored * np.float64(depth_scale)).astype(np.float32)


def read_mask(path: str | Path) -> np.ndarray:
    """Mask (H, W) bool, true where the image or array is not zero in any colour channel (alpha is ignored)."""
    path = _existing(path, DEPTH_FORMATS, "mask")
    stored = read_array(path, "mask") if path.suffix.lower() in (".npy", ".npz") else read_image(path, "RGB")
    if stored.ndim == 3:
        stored = stored.any(-1)
    if stored.ndim != 2:
        raise InputError(f"{path}: a mask needs shape (H, W), got {stored.shape}")
    return stored != 0


def is_cloud(path: str | Path) -> bool:
    """Whether a file holds points rather than a depth image, by its extension; NPY and NPZ by what is in them."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in DEPTH_FORMATS or suffix not in CLOUD_FORMATS:
        return suffix in CLOUD_FORMATS
    try:
        loaded = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(loaded, np.ndarray):
            with loaded:
                if "points" in loaded.files or "depth" in loaded.files:
                    return "points" in loaded.files
                loaded = loaded[loaded.files[0]]
    except Exception:  # whoever reads it next says what is wrong
        return suffix == ".npz"
    columns = loaded.shape[-1] if loaded.ndim else 0
    return columns == 3 if loaded.ndim == 3 else 3 <= columns < 10  # no depth image is so narrow


def read_cloud(path: str | Path) -> np.ndarray:
    """Points (N, 3) float64 in the file's own unit from PLY, PCD, XYZ or text, NPY or NPZ (array ``points``).

    Rows that are not finite are kept (an observation drops them). Further columns (colours, normals) are ignored.
    Raises InputError for a missing, unreadable or foreign file.
    """
    path = _existing(path, CLOUD_FORMATS, "point cloud")
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        points = read_array(path, "points")
    else:
        reader = {".ply": _read_ply, ".pcd": _read_pcd}.get(suffix, _read_text)
        try:
            points = reader(path)
        except InputError:
            raise
        except Exception as error:  # readers of foreign formats raise anything at all
            raise InputError(
                f"{path}: not readable as {suffix[1:].upper()} ({one_line(error)}); export it again"
            ) from error
    if points.ndim == 3 and points.shape[-1] >= 3:  # an organised cloud (H, W, 3)
        points = points.reshape(-1, points.shape[-1])
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "iuf":
        raise InputError(f"{path}: a cloud needs shape (N, 3), got {points.dtype} of shape {points.shape}")
    return points[:, :3].astype(np.float64)


def _existing(path: str | Path, formats: tuple[str, ...], kind: str) -> Path:
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of a {kind}")
    if path.suffix.lower() not in formats:
        raise InputError(f"{path}: unknown {kind} format {path.suffix!r}; known ones are {', '.join(formats)}")
    return path


def read_image(path: Path, mode: str | None = None) -> np.ndarray:
    """An image file as it is stored, (H, W) or (H, W, channels); with ``mode``, palettes and alpha become that mode.

    Raises InputError for a file that is not readable as an image.
    """
    try:
        with Image.open(path) as image:
            if mode is not None and image.mode in ("P", "RGBA", "LA"):
                return np.asarray(image.convert(mode))
            return np.asarray(image)
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: not readable as an image ({one_line(error)}); export it again") from error


def read_array(path: Path, key: str) -> np.ndarray:
    """The array of an NPY, or of an NPZ the one called ``key`` or the only one."""
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return loaded
        with loaded:
            names = loaded.files
            if key not in names and len(names) != 1:
                raise InputError(f"{path}: holds {', '.join(names) or 'nothing'}; name the array {key!r}")
            return loaded[key if key in names else names[0]]
    except InputError:
        raise
    except Exception as error:  # a damaged file raises anything from EOFError to zlib.error
        raise InputError(f"{path}: not readable as {path.suffix[1:].upper()} ({one_line(error)})") from error


def _read_ply(path: Path) -> np.ndarray:
    loaded = trimesh.load(path, process=False)
    vertices = getattr(loaded, "vertices", None)
    if vertices is None:
        raise InputError(f"{path}: holds no vertices; export a point cloud")
    return np.asarray(vertices)


def _read_text(path: Path) -> np.ndarray:
    """One point a line, separated by space or commas; '#' starts a comment."""
    lines = [line.replace(",", " ") for line in path.read_text(encoding="utf-8").splitlines()]
    if not any(line.split("#")[0].strip() for line in lines):  # loadtxt would warn on stderr and go on
        raise InputError(f"{path}: holds no points; give lines of x y z")
    return np.loadtxt(lines, ndmin=2)


PCD_KINDS = {"F": "f", "I": "i", "U": "u"}


def _read_pcd(path: Path) -> np.ndarray:
    """x, y, z of a PCD file, ascii, binary or binary_compressed."""
    data = path.read_bytes()
    header: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in header:
        end = data.index(b"\n", start)
        words = data[start:end].decode("ascii").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        start = end + 1
    names, encoding = header["FIELDS"], header["DATA"][0].lower()
    sizes = header["SIZE"]
    counts = [int(c) for c in header.get("COUNT", ["1"] * len(names))]
    kinds = [PCD_KINDS[k.upper()] for k in header["TYPE"]]
    points = int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
    first = np.cumsum([0] + counts)
    place = [names.index(axis) for axis in "xyz"]
    if encoding == "ascii":
        table = np.loadtxt(data[start:].decode("ascii").splitlines(), ndmin=2)
        return table[:points, first[place]]
    # padding fields share the name '_', so fields are told apart by index
    dtypes = [np.dtype(f"<{kind}{size}") for kind, size in zip(kinds, sizes, strict=True)]
    if encoding == "binary":
        record = np.dtype([(f"f{i}", d, (c,)) for i, (d, c) in enumerate(zip(dtypes, counts, strict=True))])
        table = np.frombuffer(data, record, points, start)
        return np.concatenate([table[f"f{i}"] for i in place], 1).astype(np.float64)
    raise InputError(f"{path}: PCD encoding {encoding!r} is not supported; save it as ascii or binary")


def one_line(error: Exception) -> str:
    """The message of a foreign error on one line."""
    return " ".join(str(error).split()) or type(error).__name__
