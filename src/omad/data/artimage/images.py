"""Images of an ArtImage download, as views with their truth."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from omad.common.decode import Within, decode
from omad.common.errors import InputError, shown
from omad.common.incoming import read_json, read_text
from omad.geometry.camera import Camera
from omad.objects.category import Category
from omad.sensing.camera_files import read_intrinsics
from omad.sensing.depth_files import read_image

from ..broken import Broken, passing_over
from ..rendering.rasteriser import NOTHING
from ..rendering.standard_views import View
from .annotations import Annotation, read_annotation
from .layout import AGAIN, SPLITS, Layout, Split, depth_step, peculiarities
from .objects import ArtImageObject, read_object, read_rest_states


@dataclass(frozen=True)
class Size:
    """Of all images, pixels."""

    width: Annotated[int, Within(1, 30_000)]
    height: Annotated[int, Within(1, 30_000)]


@dataclass(frozen=True)
class ArtImage:
    """The images of one category and split; iterate over it for its views, in the order of their lists. Depth and truth
    are in metres, and only pixels of the object's box have depth."""

    category: Category
    camera: Camera
    objects: dict[str, ArtImageObject]
    annotations: tuple[Annotation, ...]
    broken: Broken
    left_out: list[dict[str, str]] = field(default_factory=list)
    """{"name": of the annotation or object, "reason": one line}; grows while images are read."""

    def __len__(self) -> int:
        return len(self.annotations)

    def __iter__(self) -> Iterator[View]:
        whole = []
        for annotation in self.annotations:  # what is missing is known before the work begins
            with passing_over(self.broken, self.left_out, annotation.path.name):
                _check_there(annotation.depth, annotation.mask)
                whole.append(annotation)
        for annotation in whole:
            view = None
            with passing_over(self.broken, self.left_out, annotation.path.name):
                view = self.view(annotation)
            if view is not None:
                yield view

    def view(self, annotation: Annotation) -> View:
        """The image of one annotation. Raises InputError where it is not readable."""
        category, thing = self.category, self.objects[annotation.object]
        _check_there(annotation.depth, annotation.mask)
        stored, mask = self._stored(annotation.depth, (1, 256, 0)), self._stored(annotation.mask, (0, 0, 1))
        x1, y1, x2, y2 = annotation.box
        depth = np.zeros(stored.shape, dtype=np.float32)
        depth[y1:y2, x1:x2] = stored[y1:y2, x1:x2] * depth_step(category)
        if not depth.any():
            raise InputError(f"{annotation.depth}: no depth inside the box {annotation.box}; leave this image out")
        part_of = np.full(max(256, int(mask.max()) + 1), NOTHING, dtype=np.uint8)
        part_of[list(thing.links)] = np.arange(len(thing.links))
        T_camera_model = annotation.T_camera_base.copy()
        T_camera_model[:3, 3] *= category.metres_per_unit
        T_camera_base = T_camera_model @ np.linalg.inv(thing.T_canonical_base)
        labels = np.where(depth > 0, part_of[mask], np.uint8(NOTHING))
        states = thing.states([annotation.states[link - 1] for link in thing.links[1:]], category)
        return View(thing.truth, depth, labels, self.camera, states, T_camera_base, seed=())

    def _stored(self, path: Path, channels: tuple[int, int, int]) -> np.ndarray:
        """(H, W) integers of an image: its only channel, or red, green and blue times ``channels``."""
        stored = read_image(path, path, "RGB").astype(np.int64)
        if stored.shape[:2] != (self.camera.height, self.camera.width):
            raise InputError(f"{path}: {stored.shape} pixels do not fit the camera's; {AGAIN}")
        return stored if stored.ndim == 2 else stored[..., :3] @ channels


def open_artimage(root: Path | str, category: Category, split: Split, broken: Broken = "refuse") -> ArtImage:
    """Images and objects of one category and split of an ArtImage root.

    ``broken="refuse"`` raises InputError at the first broken file; ``"skip"`` leaves out the annotation or the object
    that it belongs to, says so on stderr, and lists it. InputError is raised in any case where the root, the lists,
    the camera or the rest states are missing, or nothing is left.
    """
    layout = Layout(Path(root), category.name)
    if Layout(layout.root.parent, layout.root.name).annotation("").is_dir():
        raise InputError(f"{root}: is the folder of one category; give the one above it")
    if not layout.folder.is_dir():
        raise InputError(f"{root}: no folder {category.name} in it; give an ArtImage root that has this category")
    rest_states = read_rest_states(layout)
    left_out: list[dict[str, str]] = []
    train, test = (_listed(layout, split) for split in SPLITS)
    found: dict[str, Annotation] = {}
    for name in dict.fromkeys(train + test):
        with passing_over(broken, left_out, name):
            found[name] = read_annotation(layout, name, len(category.parts))
    # test objects are the authors', and those whose images only the test list names
    trained = {found[name].object for name in train if name in found}
    tested = peculiarities(category).test_objects | {each.object for each in found.values()} - trained
    chosen = [each for each in found.values() if (each.object in tested) == (split == "test")]
    objects: dict[str, ArtImageObject] = {}
    for name in dict.fromkeys(annotation.object for annotation in chosen):
        with passing_over(broken, left_out, name):
            objects[name] = read_object(layout, name, rest_states, category)
    chosen = tuple(annotation for annotation in chosen if annotation.object in objects)
    if not chosen:
        reason = left_out[0]["reason"] if left_out else f"{layout.valid('train')} and {layout.valid('test')} name none"
        raise InputError(f"{layout.folder}: no usable image of the {split} split ({reason})")
    return ArtImage(category, _read_camera(layout), objects, chosen, broken, left_out)


def _listed(layout: Layout, split: Split) -> list[str]:
    """Annotation names in the order of a split's list."""
    path = layout.valid(split)
    if not path.is_file():
        raise InputError(f"{path}: missing; download it again, or finish the rendering that was to write it")
    names = [name for line in read_text(path, AGAIN, errors="replace").splitlines() if (name := line.strip())]
    if outside := [name for name in names if "/" in name or "\\" in name or "\0" in name]:
        raise InputError(f"{path}: names {shown(repr(outside[0]))}, which is no file of the annotations; {AGAIN}")
    return names


def _read_camera(layout: Layout) -> Camera:
    record = read_json(layout.camera, AGAIN)
    K = read_intrinsics(layout.camera)
    try:
        size = decode(Size, {"width": record["width"], "height": record["height"]})
        return Camera.from_K(K, size.width, size.height)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{layout.camera}: no width and height; {AGAIN}") from error


def _check_there(*paths: Path) -> None:
    for path in paths:
        if not path.is_file():
            raise InputError(f"{path}: missing; download it again, or take it off the list")
