"""What lies beside a depth image and says how to read it: its camera, its scale, its mask, its colours.

Of ``x.png`` or ``x.depth.png`` these are, the first that tells counts: ``x.json`` or ``x.yaml``, ``camera.json`` or
``camera.yaml`` in its folder, and in its folder or the one above ``dataset.json``, as ``omad render`` writes it, or
``scene_camera.json``, in which BOP's data sets have a camera for each image by its number. The mask is
``x.mask.png``, the colour image ``x.color.png`` or ``x.color.jpg``. A file with neither intrinsics nor ``depth_scale``
is not for it, and passed over, as is in a folder of inputs a picture ``x.png`` beside an ``x.ply``. Where none of them
tells ``depth_scale``, a PNG's own text of that name does.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image

from omad.common.errors import InputError
from omad.common.incoming import IMAGE_FORMATS
from omad.common.limits import limits

from .camera_files import SCALE, CameraFile, camera_of, of_image, read_table, scale_of, tells_of_camera

OF_DEPTH = ".depth"
COMPANIONS = (".mask", ".labels", ".instances", ".color")
"""What an image's name has before its extension where it belongs to a depth image, and is none."""


@dataclass(frozen=True)
class Beside:
    """What files beside one depth image tell."""

    camera: CameraFile | None = None
    depth_scale: float | None = None
    """Metres per stored integer."""
    mask: Path | None = None
    color: Path | None = None
    camera_file: Path | None = None
    """Whose word the camera is ..."""
    scale_file: Path | None = None
    """... and the scale."""

    @classmethod
    def of(cls, depth: Path) -> "Beside":
        """Raises InputError for a file beside it that tells of a camera and is wrong."""
        stem = depth.stem.removesuffix(OF_DEPTH)
        camera = scale = camera_file = scale_file = None
        for file in _files(depth.parent, stem):
            table = of_image(_table(file), stem)
            if camera is None and tells_of_camera(table):
                camera, camera_file = camera_of(table, file), file
            if scale is None and (scale := scale_of(table, file)) is not None:
                scale_file = file
            if camera is not None and scale is not None:
                break
        if scale is None and depth.suffix.lower() == ".png" and (scale := scale_in_text(depth, depth)) is not None:
            scale_file = depth
        mask, *colors = _images(depth.parent, stem)
        color = next((file for file in colors if file.is_file()), None)
        return cls(camera, scale, mask if mask.is_file() else None, color, camera_file, scale_file)


def companion(depth: Path, kind: str) -> str:
    """The stem of a depth image's mask or colour image, say, beside it."""
    return f"{depth.stem.removesuffix(OF_DEPTH)}.{kind}"


def is_companion(file: Path) -> bool:
    """Whether an image belongs to a depth image, by its name, as ``00000.labels.png`` does."""
    return Path(file.stem).suffix.lower() in COMPANIONS


def is_picture(file: Path) -> bool:
    """Whether a file is an image of colours, or of few greys: of ``x.ply``, say, ``x.png`` is no depth image then."""
    with suppress(OSError, ValueError, Image.DecompressionBombError), Image.open(file, formats=IMAGE_FORMATS) as image:
        return image.mode[0] not in "IF"
    return False


def scale_in_text(png: Path | BytesIO, name: str | Path) -> float | None:
    """``depth_scale``, where a PNG's text tells it; None of other files. Raises InputError with the ``name`` where it
    is none."""
    unreadable = suppress(OSError, ValueError, SyntaxError, Image.DecompressionBombError)
    told: Any = None
    with unreadable, Image.open(png, formats=["PNG"]) as image:
        told = image.info.get(SCALE)
    return None if told is None else scale_of({SCALE: told}, name)


def may_lie_beside(depth: Path) -> Iterator[Path]:
    """Files whose contents count for a depth image, where they are there."""
    stem = depth.stem.removesuffix(OF_DEPTH)
    yield from _files(depth.parent, stem)
    yield from _images(depth.parent, stem)


def _images(folder: Path, stem: str) -> list[Path]:
    return [folder / f"{stem}{end}" for end in (".mask.png", ".color.png", ".color.jpg")]


def _files(folder: Path, stem: str) -> Iterator[Path]:
    for name in (stem, "camera"):
        yield from (folder / f"{name}{suffix}" for suffix in (".json", ".yaml", ".yml"))
    for name in ("dataset.json", "scene_camera.json"):
        yield from (folder / name, folder.absolute().parent / name)


def _table(file: Path) -> Any:
    """None where there is none."""
    try:
        status = file.stat()
    except OSError:
        return None
    if status.st_size > limits().camera_bytes:
        return None
    return _read(file, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _read(file: Path, changed: int, size: int) -> Any:
    """Read once, though a folder of a million images asks for it; ``changed`` and ``size`` tell another file."""
    try:
        return read_table(file)
    except InputError:
        return None  # whatever it is, it is not a camera's
