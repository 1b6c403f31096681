"""Depth images and clouds given to a command, with the options that say how to read them."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Literal, Self

import numpy as np

from omad.common.errors import InputError, named, shown
from omad.common.incoming import is_file
from omad.geometry.camera import Camera

from .beside import Beside, companion, is_companion, is_picture
from .camera_files import CameraFile, parse_distortion, read_camera, read_transform
from .colour_mask import ColourCamera
from .depth_files import (
    CLOUD_FORMATS,
    COLOR_FORMATS,
    DEPTH_FORMATS,
    MASK_FORMATS,
    MILLIMETRES,
    holds_mask,
    is_cloud,
    read_cloud,
    read_color,
    read_depth,
    read_mask,
)
from .input_options import CameraOptions, FrameOptions, InputOptions
from .masks import as_mask
from .observation import Observation

KNOWN = sorted({*DEPTH_FORMATS, *CLOUD_FORMATS} - {".txt"})
"""Extensions of inputs in a folder, where a text file is no cloud but a note."""
INTRINSICS = "--intrinsics"
NEED_INTRINSICS = "a depth image needs --intrinsics fx,fy,cx,cy or a file with them (camera.json beside it is read)"
APART = 0.01
"""Share by which a scale given differs from the one that a file beside the image tells; of the focal length, by which a
camera's numbers do."""
NUMBERS = np.array([["fx", "skew", "cx"], ["skew", "fy", "cy"], ["", "", ""]])
"""What those of a matrix of intrinsics are called."""
APART_CAMERAS = 3.0
"""Metres between depth and colour camera that no rig has."""
LARGEST = 1e9
"""Of numbers in an option; no image has so many pixels along a side."""
NO_FRAME = FrameOptions()
Find = Callable[[Observation, Sequence[float] | None], Observation]
"""Of a whole frame the object, within a box where one is given."""


@dataclass(frozen=True)
class InputReader:
    """Reads inputs as a command's options say."""

    camera: CameraFile | None
    """Of the depth images; without, what lies beside each says it."""
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
    color: np.ndarray | Path | None = None
    """What a colour camera saw, of every input, or the folder of theirs; for pictures."""
    distortion: str | None = None
    """The lens in place of the camera's own, as ``parse_distortion`` takes it."""
    find: Find | None = None
    """Cuts the object out of whole frames where nothing else says which it is but a box."""
    without_masks: bool = False
    """A mask that lies beside a frame says nothing."""

    @classmethod
    def of(cls, options: InputOptions, files: list[Path], frame: FrameOptions = NO_FRAME) -> Self:
        """Read what holds for all inputs. Raises InputError where that is wrong whatever the input, and where all of
        ``files`` need intrinsics and there are none."""
        if options.intrinsics is None and files and not any(map(tells_camera, files)):
            _existing(files[0])
            raise InputError(f"{files[0]}: {NEED_INTRINSICS}")
        mask, box = options.mask, options.box
        camera = None if options.intrinsics is None else read_camera(options.intrinsics)
        if frame.distortion is not None:
            parse_distortion(frame.distortion)
        if mask is not None and os.path.abspath(mask) in map(os.path.abspath, files) and not holds_mask(mask):
            raise InputError(f"--mask {mask}: is the depth image itself; give its mask")
        masks = mask if mask is None or mask.is_dir() else read_mask(mask, options.mask_id)
        if isinstance(masks, Path):
            check_masks_apart(files, masks)
        corners = None if box is None else parse_numbers(box, 4, "--box")
        colour = _colour_camera(frame, mask is not None or box is not None or frame.color is not None)
        seen = None if frame.color is None else frame.color if frame.color.is_dir() else read_color(frame.color)
        region = {"mask": masks, "box": corners, "segment": options.segment, "mask_id": options.mask_id}
        lens = {"colour": colour, "distortion": frame.distortion, "color": seen}
        return cls(camera, **region, depth_scale=options.depth_scale, drop_flying=frame.drop_flying, **lens)

    def __call__(self, file: Path) -> Observation:
        """One input. Raises InputError with its name."""
        _existing(file)
        with named(file):
            return self._cloud(file) if is_cloud(file) else self._depth(file)

    def whole(self, file: Path) -> tuple[Observation, Sequence[float] | None]:
        """An input's whole frame, and the box in its pixels where there is one. Raises InputError with its name."""
        boxes: list[Sequence[float] | None] = []

        def keep(frame: Observation, box: Sequence[float] | None) -> Observation:
            boxes.append(box)
            return frame

        return replace(self, find=keep, without_masks=True)(file), boxes[0]

    def _cloud(self, file: Path) -> Observation:
        if self.mask is not None or self.box is not None or self.mask_id is not None:
            cure = "cut the cloud out" if self.without_masks else "cut the cloud out, or use --segment plane"
            raise InputError(f"--mask and --box need a depth image; {cure}")
        if self.color is not None or self.colour is not None:
            raise InputError("--color and --color-intrinsics need a depth image; leave them out of a cloud")
        if self.distortion is not None:
            raise InputError("--distortion needs a depth image; leave it out of a cloud")
        points = read_cloud(file) * (self.depth_scale or 1.0)
        if self.find is None or self.segment is not None:
            return Observation.from_points(points, self.segment, self.drop_flying)
        seen = self.find(Observation.from_points(points), None)
        return seen.without_strays() if self.drop_flying else seen

    def _depth(self, file: Path) -> Observation:
        beside = Beside.of(file)
        mask = self._mask(file, beside)
        depth = read_depth(file, self.depth_scale, self.metres_per_integer(beside.depth_scale))
        color, warnings = self.color if self.color is not None else beside.color, list[str]()
        if isinstance(color, Path):
            color = read_color(_of_its_name(file, color, "color", COLOR_FORMATS) if color.is_dir() else color)
        if self.color is None and self.colour is None and color is not None and color.shape[:2] != depth.shape:
            warnings = [f"{beside.color} does not lie on the depth image, and is not shown; give --color-intrinsics"]
            color = None
        camera, told_by = (beside.camera, str(beside.camera_file)) if self.camera is None else (self.camera, INTRINSICS)
        seen = self.observe(depth, mask, camera, color, told_by)
        return seen.warned(*self._contradicted(beside), *warnings)

    def _mask(self, file: Path, beside: Beside) -> np.ndarray | None:
        if isinstance(self.mask, Path):
            return read_mask(_of_its_name(file, self.mask, "mask", MASK_FORMATS), self.mask_id)
        told = self.without_masks or self.mask is not None or self.box is not None or self.segment is not None
        if not told and (own := beside.mask or (file if holds_mask(file) else None)):
            return read_mask(own, self.mask_id)
        self.check_mask_id()
        return self.mask

    def check_mask_id(self) -> None:
        """Raises InputError for the number of an object where no mask tells the objects."""
        if self.mask is None and self.mask_id is not None:
            raise InputError(f"--mask-id {self.mask_id}: tells one of a mask's objects; give --mask, or leave it out")

    def metres_per_integer(self, told: float | None = None) -> float:
        """Of a depth image of which --depth-scale says nothing; ``told``: what lies beside it tells."""
        return (self.camera and self.camera.depth_scale) or told or MILLIMETRES

    def metres_per_number(self, file: Path) -> float | None:
        """Of a depth image or cloud, where that can be told without its numbers."""
        if is_cloud(file):
            return self.depth_scale or 1.0
        if self.depth_scale is not None or file.suffix.lower() != ".png":
            return self.depth_scale
        return self.metres_per_integer(Beside.of(file).depth_scale)

    def _contradicted(self, beside: Beside) -> Iterator[str]:
        """Where the options say other than what lies beside the image."""
        given = self.depth_scale, beside.depth_scale, beside.scale_file
        pairs: list[tuple[str, float | None, float | None, Path | None]] = [("--depth-scale", *given)]
        if self.camera is not None and self.depth_scale is None:
            pairs.append(("the depth_scale of --intrinsics", self.camera.depth_scale, *given[1:]))
        for what, given, told, teller in pairs:
            if given is not None and told is not None and abs(given / told - 1) > APART:
                yield f"{what} is {given:g}, but {teller} tells {told:g}: leave it out to use that"
        if self.camera is not None and beside.camera is not None:
            given, told = self.camera.K, beside.camera.K
            apart = np.abs(given - told)
            if apart.max() > APART * told[0, 0]:
                place = np.unravel_index(apart.argmax(), apart.shape)
                what = f"{NUMBERS[place]} of --intrinsics is {given[place]:g}, but {beside.camera_file}"
                yield f"{what} tells {told[place]:g}: leave it out to use that"

    def observe(
        self,
        depth: np.ndarray,
        mask: np.ndarray | None,
        camera: CameraFile | None = None,
        color: np.ndarray | None = None,
        told_by: str = INTRINSICS,
    ) -> Observation:
        """A depth image (H, W) in metres that was read already, with its mask and colours; ``camera``: its own, in
        place of that of all, and ``told_by`` what or whom. A mask that is not of booleans may be a label image. Raises
        InputError."""
        camera, box = camera or self.camera, self.box
        if camera is None:
            raise InputError(NEED_INTRINSICS)
        height, width = depth.shape
        if camera.size not in (None, (width, height)):
            told = f"{'x'.join(map(str, camera.size))}; {_of_this_size(camera, width, height)}"
            raise InputError(f"the image is {width}x{height}, but the camera of {told_by} is for {told}")
        lens = camera.distortion if self.distortion is None else parse_distortion(self.distortion)
        camera = camera.without_lens() if self.distortion is not None and lens is None else camera
        whole = Camera.from_K(camera.K, width, height, lens)
        if mask is not None and mask.dtype != bool:
            mask = as_mask(mask, self.mask_id)
        if self.colour is not None:
            color = None if color is None else self.colour.seen_from_depth(depth, whole, color)
            if mask is None and box is not None and self.find is not None and self.segment is None:
                box = self.colour.depth_box(depth, whole, box)
            elif mask is not None or box is not None:
                mask, box = self.colour.depth_mask(depth, whole, mask, box), None
        if self.find is None or mask is not None or self.segment is not None:
            return Observation.from_depth(depth, whole, mask, box, self.segment, self.drop_flying, color=color)
        seen = self.find(Observation.from_depth(depth, whole, color=color), box)
        return seen.without_strays() if self.drop_flying else seen


def _of_this_size(camera: CameraFile, width: int, height: int) -> str:
    """What to do about a camera that is told to be of another size."""
    cure = "give --intrinsics of the depth stream at this size"
    across, down = camera.size or (width, height)
    if (across, down) == (height, width):
        return f"{cure}, or turn the image back by 90 degrees"
    if camera.distortion is not None or across * height != down * width:
        return cure
    scale = width / across
    centre = (camera.K[:2, 2] + 0.5) * scale - 0.5  # of the first pixel 0 is the middle
    scaled = ",".join(f"{number:.6g}" for number in (camera.K[0, 0] * scale, camera.K[1, 1] * scale, *centre))
    return f"{cure}; of images that were only scaled that is --intrinsics {scaled}"


def tells_camera(file: Path) -> bool:
    """Whether an input needs no intrinsics: a cloud, or a depth image whose camera is told beside it."""
    return is_cloud(file) or (file.is_file() and Beside.of(file).camera is not None)


def check_masks_apart(files: Iterable[Path], masks: Path) -> None:
    """Raises InputError where one mask of a folder would be that of inputs in several folders, by their name."""
    folders: dict[tuple[Path, str], Path] = {}
    for file in files:
        other = folders.setdefault((_for_those_in(file.parent, masks), file.stem), file.parent)
        if other != file.parent:
            cure = f"lay those of {file.parent} into {masks / _name(file.parent)}"
            raise InputError(f"--mask {masks}: has one mask for {other / file.name} and {file}; {cure}")


def _for_those_in(folder: Path, masks: Path) -> Path:
    """Where among ``masks`` those of a folder's inputs lie: in a sub-folder of its name, if there is one."""
    own = masks / _name(folder)
    return own if own.is_dir() else masks


def _name(folder: Path) -> str:
    return os.path.basename(os.path.abspath(folder))


def _of_its_name(file: Path, folder: Path, kind: str, formats: Sequence[str]) -> Path:
    """That with the input's name, whatever its extension, or as it is called beside its input; not the input itself,
    but where it holds its mask."""
    folder = _for_those_in(file.parent, folder)
    stems = file.stem, companion(file, kind)
    for stem, suffix in product(stems, formats):  # quicker than to list the folder, where it holds a million
        if (found := folder / (stem + suffix)).is_file() and _serves(found, file, kind):
            return found
    found = sorted(each for each in folder.iterdir() if each.stem in stems and _serves(each, file, kind))
    if not found:
        raise InputError(f"{folder}: no {kind} for {file} in it; name them like the inputs")
    return found[0]


def _serves(found: Path, file: Path, kind: str) -> bool:
    return not found.samefile(file) or (kind == "mask" and holds_mask(file))


def _colour_camera(frame: CameraOptions, region: bool) -> ColourCamera | None:
    intrinsics, extrinsics = frame.color_intrinsics, frame.color_extrinsics
    if intrinsics is None and extrinsics is None:
        return None
    if intrinsics is None or extrinsics is None:
        raise InputError("--color-intrinsics and --color-extrinsics: give both, or neither for depth aligned to colour")
    if not region:
        raise InputError("--color-intrinsics: serves a --color, --mask or --box of the colour image; give one of them")
    T_color_depth = read_transform(extrinsics, "T_color_depth")
    if (apart := float(np.linalg.norm(T_color_depth[:3, 3]))) > APART_CAMERAS:
        raise InputError(f"{extrinsics}: T_color_depth moves by {apart:.3g} m; give its translation in metres")
    return ColourCamera(read_camera(intrinsics), T_color_depth)


def input_files(paths: Sequence[Path]) -> list[Path]:
    """Files given, and those in folders given; each once."""
    if not paths:
        raise InputError("no input; give a depth image, a cloud, or a folder of them")
    files: list[Path] = []
    for path in paths:
        inside = files_in(path) if path.is_dir() else [path]
        if not inside and files_in(path, "*/[!.]*"):
            raise InputError(f"{path}: depth images or clouds lie in its sub-folders; give {path}/*/, or one of them")
        if not inside:
            raise InputError(f"{path}: no depth image or cloud in it; known: {' '.join(KNOWN)}")
        files += inside
    return list({os.path.abspath(file): file for file in files}.values())


def files_in(folder: Path, pattern: str = "[!.]*") -> list[Path]:
    """Depth images and clouds in a folder, without the masks and labels of ``omad render`` and pictures with the name
    of another one; ``**/[!.]*``: in its sub-folders, too, but for hidden ones."""
    known = (path for path in folder.glob(pattern) if path.suffix.lower() in KNOWN and not is_companion(path))
    seen = (path for path in known if not any(part[0] == "." for part in path.relative_to(folder).parts))
    files = sorted(path for path in seen if path.is_file())
    named = Counter(path.with_suffix("") for path in files)
    return [path for path in files if named[path.with_suffix("")] == 1 or not is_picture(path)]


def _existing(file: Path) -> None:
    if os.path.isdir(file):
        raise InputError(f"{file}: is a folder; give one depth image or cloud")
    if not is_file(file):
        raise InputError(f"{shown(file)}: no such file or folder; give a depth image, a cloud, or a folder of them")


def parse_numbers(text: str, count: int, name: str) -> list[float]:
    """So many numbers with commas between them. Raises InputError that names the option."""
    with suppress(ValueError):
        values = [float(word) for word in text.split(",")]
        if len(values) == count and all(abs(value) <= LARGEST for value in values):
            return values
    raise InputError(f"{name} {shown(text)}: expected {count} numbers up to {LARGEST:g} with commas between them")
