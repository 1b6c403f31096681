"""Depth images and clouds given to a command, with the options that say how to read them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from .camera import Camera
from .camera_files import CameraFile, parse_distortion, read_camera, read_transform
from .errors import InputError
from .files import CLOUD_FORMATS, DEPTH_FORMATS, is_cloud, read_cloud, read_depth, read_mask
from .observation import Observation
from .registration import ColourCamera


class InputOptions(Protocol):
    """The options that commands which read observations share."""

    @property
    def intrinsics(self) -> str | None: ...
    @property
    def mask(self) -> Path | None: ...
    @property
    def box(self) -> str | None: ...
    @property
    def segment(self) -> Literal["plane"] | None: ...
    @property
    def depth_scale(self) -> float | None: ...


@dataclass(frozen=True)
class FrameOptions:
    """Options of a frame of one's own camera, as they are written on the command line."""

    distortion: str | None = None
    """In place of what the intrinsics' file tells of the lens."""
    color_intrinsics: str | None = None
    color_extrinsics: Path | None = None
    drop_flying: bool = False


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

    @classmethod
    def of(cls, options: InputOptions, files: list[Path], frame: FrameOptions | None = None) -> InputReader:
        """Read what holds for all inputs. Raises InputError where that is wrong whatever the input."""
        frame = frame or FrameOptions()
        if options.intrinsics is None and not any(is_cloud(file) for file in files):
            _existing(files[0])
            raise InputError(f"{files[0]}: a depth image needs --intrinsics fx,fy,cx,cy or a file with them")
        mask = options.mask
        camera = None if options.intrinsics is None else read_camera(options.intrinsics)
        if frame.distortion is not None and camera is not None:
            camera = replace(camera, distortion=parse_distortion(frame.distortion))
        return cls(
            camera=camera,
            mask=mask if mask is None or mask.is_dir() else read_mask(mask),
            box=None if options.box is None else parse_numbers(options.box, 4, "--box"),
            segment=options.segment,
            depth_scale=options.depth_scale,
            drop_flying=frame.drop_flying,
            colour=_colour_camera(frame, mask is not None or options.box is not None),
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
        points = read_cloud(file) * (self.depth_scale or 1.0)
        return Observation.from_points(points, self.segment, self.drop_flying)

    def _depth(self, file: Path) -> Observation:
        depth = read_depth(file, self.depth_scale)
        camera = self.camera
        if camera is None:
            raise InputError("a depth image needs --intrinsics fx,fy,cx,cy or a file with them")
        height, width = depth.shape
        if camera.size not in (None, (width, height)):
            raise InputError(
                f"is {width}x{height}, but its --intrinsics are for {camera.size[0]}x{camera.size[1]};"
                " give those of the depth stream at this size"
            )
        mask = read_mask(_mask_of(file, self.mask)) if isinstance(self.mask, Path) else self.mask
        box, lens = self.box, camera.distortion
        if self.colour is not None:
            mask = self.colour.depth_mask(depth, Camera.from_K(camera.K, width, height), lens, mask, box)
            box = None
        return Observation.from_depth(depth, camera.K, mask, box, self.segment, self.drop_flying, lens)


def _colour_camera(frame: FrameOptions, region: bool) -> ColourCamera | None:
    given = frame.color_intrinsics, frame.color_extrinsics
    if given == (None, None):
        return None
    if frame.color_intrinsics is None or frame.color_extrinsics is None:
        raise InputError("--color-intrinsics and --color-extrinsics: give both, or neither for depth aligned to colour")
    if not region:
        raise InputError("--color-intrinsics: serves a --mask or --box drawn in the colour image; give one of them")
    return ColourCamera(read_camera(frame.color_intrinsics), read_transform(frame.color_extrinsics, "T_color_depth"))


def input_files(paths: Sequence[Path]) -> list[Path]:
    """Files given, and those in folders given; each once."""
    if not paths:
        raise InputError("no input; give a depth image, a cloud, or a folder of them")
    known = sorted({*DEPTH_FORMATS, *CLOUD_FORMATS} - {".txt"})  # a text file in a folder is no cloud but a note
    files: list[Path] = []
    for path in paths:
        inside = [path]
        if path.is_dir():
            inside = sorted(p for p in path.glob("[!.]*") if p.suffix.lower() in known and p.is_file())
        if not inside:
            raise InputError(f"{path}: no depth image or cloud in it; known: {' '.join(known)}")
        files += inside
    return list({os.path.abspath(file): file for file in files}.values())


def _existing(file: Path) -> None:
    if not file.is_file():
        raise InputError(f"{file}: no such file or folder; give a depth image, a cloud, or a folder of them")


def _mask_of(file: Path, folder: Path) -> Path:
    """The mask of an input in a folder of masks: that with the input's name, whatever its extension."""
    masks = sorted(mask for mask in folder.iterdir() if mask.stem == file.stem)
    if not masks:
        raise InputError(f"{folder}: no mask for {file} in it; name masks like the inputs")
    return masks[0]


def parse_numbers(text: str, count: int, name: str) -> list[float]:
    """So many numbers with commas between them. Raises InputError that names the option."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise InputError(f"{name} {text}: expected {count} numbers with commas between them")
    return values
