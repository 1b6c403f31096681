"""Reading depth images, clouds and masks as people have them."""

import io
import re
from codecs import BOM_UTF8
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError, named
from omad.common.incoming import (
    array_shapes,
    existing,
    parse_arrays,
    parse_json,
    read_arrays,
    read_bytes,
    read_image,
    read_json,
    readable,
)
from omad.common.limits import check_limit
from omad.common.lzf import decompressed

from .masks import are_annotations, as_mask, check_one_blurred_thing, of_palette

ARRAY_FORMATS = (".npy", ".npz")
MAP_FORMATS = (".pfm", ".pgm")
DEPTH_FORMATS = (".png", ".tif", ".tiff", *MAP_FORMATS, *ARRAY_FORMATS)
COLOR_FORMATS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", *ARRAY_FORMATS)
MASK_FORMATS = (*COLOR_FORMATS, ".json")
CLOUD_FORMATS = (".ply", ".pcd", ".xyz", ".txt", *ARRAY_FORMATS)
ARRAY_MAGIC, JPEG_MAGIC = (b"\x93NUMPY", b"PK"), b"\xff\xd8"
"""What arrays and JPEGs begin with."""
WEBP, LOSSLESS, HEAD = b"WEBP", b"VP8L", 48
"""How WebP is marked, which of it loses nothing, and bytes of a file within which both stand."""
_GAP = rb"(?:\s|#[^\n]*\n)+"
MAP_HEAD = re.compile(rb"(Pf|P5)" + 2 * (_GAP + rb"(\d+)") + _GAP + rb"([-+.\deE]+)\s")
"""Of a portable map: floats or integers, width, height, and then of floats a number whose sign is their byte order, of
integers the largest one that there may be."""
WIDE = 10
"""No depth image is narrower, and no cloud has so many columns."""
WIDE_TEXT = 100
"""Nor has one so many in a text, where each row of points may have more in it than is asked for."""
MILLIMETRES = 1e-3
"""Metres per stored integer of a depth image that does not say otherwise."""
SCALES = (1e-9, 1e9)
"""Which others there may be."""

FAR, NEAR = 100.0, 1e-6
"""Metres. A scene whose median distance is beyond these is of another unit ..."""
CENTIMETRES = 250.0
"""... and of this one below that many, for no camera sees so few millimetres."""
NOTHING_BACK = 2**16 - 1
"""What drivers write into images of 16 bits where nothing came back; readers may hold these in wider integers."""


def read_depth(
    path: str | Path, depth_scale: float | None = None, metres_per_integer: float = MILLIMETRES
) -> np.ndarray:
    """Depth image (H, W) float32 in metres; 0 and what is not finite mean no measurement, and so does the largest
    integer of its kind. PNG, TIFF, PFM, PGM, or an array (NPY, NPZ with one array or one named ``depth``): stored
    numbers times ``depth_scale``; without, integers times ``metres_per_integer``, and floats as they are. Raises
    InputError for a missing, unreadable or 8-bit file and for a wrong shape."""
    path = _existing(path, DEPTH_FORMATS, "depth image")
    suffix = path.suffix.lower()
    if suffix in MAP_FORMATS:
        with readable(path, suffix[1:].upper()):
            stored = _portable_map(read_bytes(path))
    else:
        stored = read_array(path, "depth") if suffix in ARRAY_FORMATS else read_image(path, path)
    return _checked_depth(stored, path, depth_scale, metres_per_integer)


def parse_depth(
    stored: bytes, name: str, depth_scale: float | None = None, metres_per_integer: float = MILLIMETRES
) -> np.ndarray:
    """What ``read_depth`` reads, of a file's bytes; ``name``: of it in messages. Raises InputError."""
    return _checked_depth(parse_stored(stored, "depth", name), name, depth_scale, metres_per_integer)


def _checked_depth(
    stored: np.ndarray, name: str | Path, depth_scale: float | None, metres_per_integer: float = MILLIMETRES
) -> np.ndarray:
    try:
        check_limit("image_pixels", stored.size, "the image")
        return in_metres(stored, depth_scale, metres_per_integer)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def parse_stored(stored: bytes, key: str, name: str, mode: str | None = None) -> np.ndarray:
    """The numbers of a file's bytes: of an image (in ``mode``, where given), an NPY, or an NPZ the array called ``key``
    or the only one. Raises InputError."""
    if MAP_HEAD.match(stored):
        with readable(name, "a portable map"):
            return _portable_map(stored)
    if not stored.startswith(ARRAY_MAGIC):
        return read_image(stored, name, mode)
    return called(parse_arrays(stored, name), key, name)


def _portable_map(stored: bytes) -> np.ndarray:
    """(H, W) of a PFM of one channel, which has its lowest row first, or a binary PGM. Pillow stretches the latter's
    integers where their largest is not that of their kind."""
    head = MAP_HEAD.match(stored)
    if head is None:
        raise ValueError("it begins with neither Pf nor P5, as maps of one channel in binary do")
    width, height, last = int(head[2]), int(head[3]), float(head[4])
    check_limit("image_pixels", width * height, "the image")
    kind = ("<f4" if last < 0 else ">f4") if head[1] == b"Pf" else ">u2" if last > np.iinfo(np.uint8).max else "u1"
    rows = np.frombuffer(stored, kind, width * height, head.end()).reshape(height, width)
    return rows[::-1] if head[1] == b"Pf" else rows


def in_metres(
    stored: np.ndarray, depth_scale: float | None = None, metres_per_integer: float = MILLIMETRES
) -> np.ndarray:
    """Depth image (H, W) float32 in metres of stored numbers, as ``read_depth`` takes them; the largest integer of
    their kind becomes 0, for drivers write it where nothing came back. Raises InputError."""
    if depth_scale is not None and not SCALES[0] <= depth_scale <= SCALES[1]:
        raise InputError(f"depth scale {depth_scale:g}: give metres per stored integer, 0.001 for millimetres")
    stored = one_channel(stored)
    if stored.ndim != 2 and stored.shape[-1:] not in ((3,), (4,)):
        raise InputError(f"{stored.dtype} of shape {stored.shape} is no depth image; one has the shape (H, W)")
    if stored.ndim != 2 or stored.dtype == np.uint8:
        cure = "(8-bit or colour images hold too few depth steps); export 16-bit single-channel depth"
        raise InputError(f"{stored.dtype} of shape {stored.shape} is no depth image {cure}")
    if stored.dtype.kind not in "iuf":
        raise InputError(f"dtype {stored.dtype} is no depth; store integers or floats")
    if stored.dtype.kind != "f" and depth_scale is not None and depth_scale > 1:
        meant = f"where {depth_scale:g} integers are a metre, it is {1 / depth_scale:g}"
        raise InputError(f"depth scale {depth_scale:g}: is in metres per stored integer; {meant}")
    usual = 1.0 if stored.dtype.kind == "f" else metres_per_integer
    metres = np.empty(stored.shape, dtype=np.float32)
    scale = np.float64(usual if depth_scale is None else depth_scale)
    np.multiply(stored, scale, out=metres, dtype=np.float64, casting="same_kind")  # in blocks, unlike astype
    if stored.dtype.kind != "f":
        largest = stored.max(initial=0)
        if largest in (np.iinfo(stored.dtype).max, NOTHING_BACK):
            metres[stored == largest] = 0
    return metres


def check_metres(distances: np.ndarray, name: str) -> None:
    """Raises InputError where distances (N,) are none that a camera sees, in metres; ``name``: of what they are of."""
    median = np.median(distances.astype(np.float64, copy=False))
    if median > FAR:
        unit, scale = ("centimetres", 0.01) if median < CENTIMETRES else ("millimetres", 0.001)
        cure = f"metres are expected; multiply by {scale} (on the command line: --depth-scale {scale})"
        raise InputError(f"{name}: median distance {median:.0f} looks like {unit}, {cure}")
    if median < NEAR:
        cure = "metres are expected; check the depth scale (on the command line: --depth-scale)"
        raise InputError(f"{name}: median distance {median:.2g} m is nothing that a camera sees, {cure}")


def one_channel(image: np.ndarray) -> np.ndarray:
    """(H, W) of an image (H, W, 1) or (1, H, W), as simulators and torch give it; anything else as it is."""
    if image.ndim != 3 or 1 not in (image.shape[0], image.shape[2]):
        return image
    return image[0] if image.shape[0] == 1 else image[..., 0]


def read_mask(path: str | Path, mask_id: int | None = None) -> np.ndarray:
    """Mask (H, W) bool of an image, an array or the JSON of a COCO segmentation, as ``as_mask`` takes them; of an image
    with a palette, ``mask_id`` is the number of a colour. Raises InputError."""
    path = _existing(path, MASK_FORMATS, "mask")
    if path.suffix.lower() == ".json":
        return _checked_mask(read_json(path, "export it again"), path, mask_id)
    if path.suffix.lower() in ARRAY_FORMATS:
        return _checked_mask(read_array(path, "mask"), path, mask_id)
    stored = _colours_or_labels(lambda mode: read_image(path, path, mode), mask_id)
    with path.open("rb") as file:
        if _is_lossy(file.read(HEAD)):
            stored = _without_loss(stored, path, mask_id)
    return _checked_mask(stored, path, mask_id)


def parse_mask(stored: bytes, name: str, mask_id: int | None = None) -> np.ndarray:
    """What ``read_mask`` reads, of a file's bytes; ``name``: of it in messages. Raises InputError."""
    if stored.removeprefix(BOM_UTF8).lstrip()[:1] in (b"{", b"["):
        check_limit("mask_text_bytes", len(stored), f"{name}: the JSON")
        return _checked_mask(parse_json(stored, name), name, mask_id)
    found = _colours_or_labels(lambda mode: parse_stored(stored, "mask", name, mode), mask_id)
    if _is_lossy(stored[:HEAD]):
        found = _without_loss(found, name, mask_id)
    return _checked_mask(found, name, mask_id)


def parse_own_mask(depth: bytes, name: str, mask_id: int | None = None) -> np.ndarray | None:
    """The mask that a depth image's bytes have in them, as ``holds_mask`` tells of a file. Raises InputError."""
    found = parse_arrays(depth, name) if depth.startswith(ARRAY_MAGIC) else None
    return _checked_mask(found["mask"], name, mask_id) if isinstance(found, dict) and "mask" in found else None


def _colours_or_labels(read: Callable[[str | None], np.ndarray], mask_id: int | None) -> np.ndarray:
    """An image, which ``read`` gives in a mode, as ``as_mask`` takes it: one with a palette holds labels, mostly."""
    stored = read("RGBA" if mask_id is None else None)
    if mask_id is not None or stored.ndim < 3:
        return stored[..., 0] if stored.shape[2:] == (2,) else stored  # grey, with transparency
    numbers = read(None)  # (H, W) of a palette alone
    return of_palette(numbers, stored) if numbers.ndim == 2 else stored


def _checked_mask(stored: Any, name: str | Path, mask_id: int | None) -> np.ndarray:
    if not isinstance(stored, np.ndarray | dict) and not are_annotations(stored):
        raise InputError(f"{name}: holds no mask; give one COCO segmentation, with size and counts")
    try:
        with readable(name, "a mask"):
            if isinstance(stored, np.ndarray):
                check_limit("image_pixels", stored.size, "the mask")
            return as_mask(stored, mask_id)
    except InputError as error:
        raise InputError(str(error) if str(name) in str(error) else f"{name}: {error}") from error


def _is_lossy(begins: bytes) -> bool:
    """Whether an image whose file so ``begins`` is a JPEG, or a WebP that is compressed as one."""
    return begins.startswith(JPEG_MAGIC) or (WEBP in begins[:12] and LOSSLESS not in begins)


def _without_loss(stored: np.ndarray, name: str | Path, mask_id: int | None) -> np.ndarray:
    """Of a mask in such an image: black and white are no longer quite that along its edge. Raises InputError for ids,
    and for objects in several colours."""
    if mask_id is not None:
        raise InputError(f"{name}: compression has blurred its ids; store label images as PNG, or leave --mask-id out")
    if stored.ndim == 3:
        with named(name):
            check_one_blurred_thing(stored[..., :3])
    grey = stored if stored.ndim == 2 else stored[..., :3].max(-1)
    return grey >= max(int(grey.max(initial=0)) // 2, 1)


def read_color(path: str | Path) -> np.ndarray:
    """Colour image (H, W, 3), or (H, W) of a grey one, of an image file or an array. Raises InputError."""
    path = _existing(path, COLOR_FORMATS, "colour image")
    return read_array(path, "color") if path.suffix.lower() in ARRAY_FORMATS else read_image(path, path, "RGB")


def is_cloud(path: str | Path) -> bool:
    """Whether a file holds points rather than a depth image, by its extension; NPY and NPZ by what is in them."""
    suffix = Path(path).suffix.lower()
    if suffix not in ARRAY_FORMATS:
        return suffix in CLOUD_FORMATS
    try:
        shapes = array_shapes(Path(path))
        if "points" in shapes or "depth" in shapes:
            return "points" in shapes
        if len(shapes) > 1:  # whichever is meant has another name
            return not any(len(shape) == 2 and shape[1] >= WIDE for shape in shapes.values())
        shape = next(iter(shapes.values()))
    except (InputError, StopIteration):  # whoever reads it next says what is wrong
        return suffix == ".npz"
    columns = shape[-1] if shape else 0
    return columns == 3 if len(shape) == 3 else 3 <= columns < WIDE


def holds_mask(depth: Path) -> bool:
    """Whether a depth image's file has its mask in it: an NPZ with ``depth`` and ``mask``."""
    return depth.suffix.lower() == ".npz" and "mask" in array_shapes(depth)


def read_cloud(path: str | Path) -> np.ndarray:
    """Points (N, 3) float64 in the file's own unit from PLY, PCD, XYZ or text, NPY or NPZ (array ``points``). Rows that
    are not finite are kept (an observation drops them). Further columns (colours, normals) are ignored. Raises
    InputError for a missing, unreadable or foreign file."""
    path = _existing(path, CLOUD_FORMATS, "point cloud")
    readers = {".ply": _read_ply, ".pcd": _read_pcd, ".xyz": _read_text, ".txt": _read_text}
    with readable(path, path.suffix[1:].upper()):
        points = readers.get(path.suffix.lower(), lambda array: read_array(array, "points"))(path)
    if points.ndim == 3 and points.shape[-1] >= 3:  # an organised cloud (H, W, 3)
        points = points.reshape(-1, points.shape[-1])
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "iuf":
        raise InputError(f"{path}: a cloud needs shape (N, 3), got {points.dtype} of shape {points.shape}")
    check_limit("cloud_points", len(points), f"{path}: the cloud")
    return points[:, :3].astype(np.float64)


def _existing(path: str | Path, formats: tuple[str, ...], kind: str) -> Path:
    path = existing(path, f"the path of a {kind}")
    if path.suffix.lower() not in formats:
        known = f"save it as one of {', '.join(formats)}"
        raise InputError(f"{path}: unknown {kind} format {path.suffix!r}; {known}")
    return path


def read_array(path: Path, key: str) -> np.ndarray:
    """The array of an NPY, or of an NPZ the one called ``key`` or the only one."""
    return called(read_arrays(path, path.suffix[1:].upper()), key, path)


def called(found: np.ndarray | dict[str, np.ndarray], key: str, name: str | Path) -> np.ndarray:
    """Of the arrays of a file the one called ``key``, or the only one. Raises InputError; ``name``: of the file."""
    if isinstance(found, np.ndarray):
        return found
    if key not in found and len(found) != 1:
        raise InputError(f"{name}: holds {', '.join(found) or 'nothing'}; name the array {key!r}")
    return found.get(key, next(iter(found.values())))


def _read_ply(path: Path) -> np.ndarray:
    import trimesh  # slow to import

    content = io.BytesIO(read_bytes(path))
    found = trimesh.load(content, file_type="ply", process=False, skip_materials=True)  # no textures
    vertices = getattr(found, "vertices", None)
    if vertices is None:
        raise InputError(f"{path}: holds no vertices; export a point cloud")
    return np.asarray(vertices)


def _read_text(path: Path) -> np.ndarray:
    """One point a line, separated by space or commas; '#' starts a comment."""
    lines = [line.replace(",", " ") for line in read_bytes(path, "cloud_text_bytes").decode("utf-8-sig").splitlines()]
    if not any(line.split("#")[0].strip() for line in lines):  # loadtxt would warn on stderr and go on
        raise InputError(f"{path}: holds no points; give lines of x y z")
    table = _table(path, lines)
    if table.shape[1] >= WIDE_TEXT:
        raise InputError(f"{path}: {table.shape[1]} numbers a line are a depth image; save it as .npy, metres")
    return table


def _table(path: Path, lines: list[str]) -> np.ndarray:
    try:
        return np.loadtxt(lines, ndmin=2)
    except ValueError as error:  # its message quotes the line
        raise InputError(f"{path}: a line is no row of numbers, or not as long as others; export it again") from error


def _read_pcd(path: Path) -> np.ndarray:
    """x, y, z of a PCD file, whatever its encoding."""
    data = read_bytes(path)
    header: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in header:
        end = data.index(b"\n", start)
        words = data[start:end].decode("ascii").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        start = end + 1
    names, encoding = header["FIELDS"], header["DATA"][0].lower()
    counts = [int(c) for c in header.get("COUNT", ["1"] * len(names))]
    points = int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
    check_limit("cloud_points", points, f"{path}: the cloud")
    place = [names.index(axis) for axis in "xyz"]
    if encoding == "ascii":
        table = _table(path, data[start:].decode("ascii").splitlines())
        return table[:points, np.cumsum([0] + counts)[place]]
    if encoding in ("binary", "binary_compressed"):
        # padding fields share the name '_', so fields are told apart by index
        fields = zip(header["TYPE"], header["SIZE"], counts, strict=True)
        kinds = [np.dtype((f"<{kind.lower()}{size}", (count,))) for kind, size, count in fields]
        record = np.dtype([(f"f{i}", kind) for i, kind in enumerate(kinds)])
        if encoding == "binary":
            table = np.frombuffer(data, record, points, start)
            return np.concatenate([table[f"f{i}"] for i in place], 1).astype(np.float64)
        length = int.from_bytes(data[start : start + 4], "little")  # and that of what it holds, which the header tells
        columns = decompressed(data[start + 8 : start + 8 + length], points * record.itemsize)
        starts = points * np.cumsum([0, *(kind.itemsize for kind in kinds)])  # field after field
        found = [np.frombuffer(columns, kinds[i], points, int(starts[i])) for i in place]
        return np.concatenate(found, 1).astype(np.float64)
    raise InputError(f"{path}: PCD encoding {encoding!r} is not supported; save it as ascii or binary")
