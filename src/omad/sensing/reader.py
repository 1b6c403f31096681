"""Depth images and clouds given to a command, with the options that say how to read them."""

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Self

import numpy as np

from omad.common.errors import InputError
from omad.geometry.camera import Camera

from .camera_files import CameraFile, parse_distortion, read_camera, read_transform
from .colour_mask import ColourCamera
from .depth_files import CLOUD_FORMATS, DEPTH_FORMATS, MASK_FORMATS, is_cloud, read_cloud, read_depth, read_mask
from .input_options import FrameOptions, InputOptions
from .observation import Observation

KNOWN = sorted({*DEPTH_FORMATS, *CLOUD_FORMATS} - {".txt"})
"""Extensions of inputs in a folder, where a text file is no cloud but a note."""
NEED_INTRINSICS = "a depth image needs --intrinsics fx,fy,cx,cy or a file with them"
NO_FRAME = FrameOptions()
Find = Callable[[Observation, Sequence[float] | None], Observation]
"""Of a whole frame the object, within a box where one is given."""


@dataclass(frozen=True)
class InputReader:
    """Reads inputs as a command's options say."""

    camera: CameraFile | None
    """Of the depth images; with the lens that is undone."""
    mask: np.ndarray | Path | None
    """Of every input, or the folder of theirs."""
    box: list[float] | None
    segment: Literal["plane"] | None
    depth_scale: float | None
    drop_flying: bool = False
    colour: ColourCamera | None = None
    """The camera that mask and box are drawn in the image of, where that is not the depth image."""
    mask_id: int | None = None
    """The object's number in masks that are label images."""
    find: Find | None = None
    """Cuts the object out of whole frames where nothing else says which it is but a box."""

    @classmethod
    def of(cls, options: InputOptions, files: list[Path], frame: FrameOptions = NO_FRAME) -> Self:
        """Read what holds for all inputs. Raises InputError where that is wrong whatever the input, and where all of
        ``files`` need intrinsics and there are none."""
        if options.intrinsics is None and files and not any(is_cloud(file) for file in files):
            _existing(files[0])
            raise InputError(f"{files[0]}: {NEED_INTRINSICS}")
        mask, box = options.mask, options.box
        camera = None if options.intrinsics is None else read_camera(options.intrinsics)
        if frame.distortion is not None and camera is not None:
            camera = replace(camera, distortion=parse_distortion(frame.distortion))
        masks = mask if mask is None or mask.is_dir() else read_mask(mask, options.mask_id)
        corners = None if box is None else parse_numbers(box, 4, "--box")
        colour = _colour_camera(frame, mask is not None or box is not None)
        return cls(
            camera, masks, corners, options.segment, options.depth_scale, frame.drop_flying, colour, options.mask_id
        )

    def __call__(self, file: Path) -> Observation:
        """One input. Raises InputError with its name."""
        _existing(file)
        try:
            return self._cloud(file) if is_cloud(file) else self._depth(file)
        except InputError as error:
            raise type(error)(str(error) if str(file) in str(error) else f"{file}: {error}") from error

    def _cloud(self, file: Path) -> Observation:
        if self.mask is not None or self.box is not None:
            raise InputError("--mask and --box need a depth image; cut the cloud out, or use --segment plane")
        return Observation.from_points(read_cloud(file) * (self.depth_scale or 1.0), self.segment, self.drop_flying)

    def _depth(self, file: Path) -> Observation:
        mask = self.mask
        if isinstance(mask, Path):
            mask = read_mask(_mask_of(file, mask), self.mask_id)
        return self.observe(read_depth(file, self.depth_scale), mask)

    def observe(self, depth: np.ndarray, mask: np.ndarray | None, camera: CameraFile | None = None) -> Observation:
        """A depth image (H, W) in metres that was read already, with its mask; ``camera``: its own, in place of that of
        all. Raises InputError."""
        camera, box = camera or self.camera, self.box
        if camera is None:
            raise InputError(NEED_INTRINSICS)
        height, width = depth.shape
        if camera.size not in (None, (width, height)):
            told = "x".join(map(str, camera.size)) + "; give those of the depth stream at this size"
            raise InputError(f"is {width}x{height}, but its --intrinsics are for {told}")
        whole = Camera.from_K(camera.K, width, height, camera.distortion)
        if self.colour is not None:
            mask, box = self.colour.depth_mask(depth, whole, mask, box), None
        if self.find is None or mask is not None or self.segment is not None:
            return Observation.from_depth(depth, whole, mask, box, self.segment, self.drop_flying)
        seen = self.find(Observation.from_depth(depth, whole), box)
        return seen.without_strays() if self.drop_flying else seen


def _mask_of(file: Path, folder: Path) -> Path:
    """That with the input's name, whatever its extension."""
    for suffix in MASK_FORMATS:  # quicker than to list the folder, where it holds a million
        if (mask := folder / (file.stem + suffix)).is_file():
            return mask
    masks = sorted(each for each in folder.iterdir() if each.stem == file.stem)
    if not masks:
        raise InputError(f"{folder}: no mask for {file} in it; name masks like the inputs")
    return masks[0]


def _colour_camera(frame: FrameOptions, region: bool) -> ColourCamera | None:
    intrinsics, extrinsics = frame.color_intrinsics, frame.color_extrinsics
    if intrinsics is None and extrinsics is None:
        return None
    if intrinsics is None or extrinsics is None:
        raise InputError("--color-intrinsics and --color-extrinsics: give both, or neither for depth aligned to colour")
    if not region:
        raise InputError("--color-intrinsics: serves a --mask or --box drawn in the colour image; give one of them")
    return ColourCamera(read_camera(intrinsics), read_transform(extrinsics, "T_color_depth"))


def input_files(paths: Sequence[Path]) -> list[Path]:
    """Files given, and those in folders given; each once."""
    if not paths:
        raise InputError("no input; give a depth image, a cloud, or a folder of them")
    files: list[Path] = []
    for path in paths:
        inside = files_in(path) if path.is_dir() else [path]
        if not inside:
            raise InputError(f"{path}: no depth image or cloud in it; known: {' '.join(KNOWN)}")
        files += inside
    return list({os.path.abspath(file): file for file in files}.values())


def files_in(folder: Path, pattern: str = "[!.]*") -> list[Path]:
    """Depth images and clouds in a folder; ``**/[!.]*``: in its sub-folders, too."""
    return sorted(path for path in folder.glob(pattern) if path.suffix.lower() in KNOWN and path.is_file())


def _existing(file: Path) -> None:
    if not file.is_file():
        raise InputError(f"{file}: no such file or folder; give a depth image, a cloud, or a folder of them")


def parse_numbers(text: str, count: int, name: str) -> list[float]:
    """So many numbers with commas between them. Raises InputError that names the option."""
    with suppress(ValueError):
        values = [float(word) for word in text.split(",")]
        if len(values) == count:
            return values
    raise InputError(f"{name} {text}: expected {count} numbers with commas between them")
