"""Annotations of an ArtImage download as they stand in their files."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from omad.common.decode import Shape
from omad.common.errors import InputError
from omad.common.incoming import read_json

from .layout import AGAIN, Layout

RIGID = 1e-2
"""Largest error of a rotation matrix."""

T = TypeVar("T")


@dataclass(frozen=True)
class Annotation:
    """One image of one object."""

    path: Path
    object: str
    box: tuple[int, int, int, int]
    """x1, y1, x2, y2, half-open pixels."""
    depth: Path
    mask: Path
    T_camera_base: np.ndarray
    """(4, 4) base in its model frame -> camera, in the file's units."""
    states: list[float]
    """Of the links 1, 2 ..., degrees or units."""


def read_annotation(layout: Layout, name: str, parts: int) -> Annotation:
    """Annotation file ``name`` of an object with ``parts`` parts. Raises InputError naming the field that is wrong."""
    path = layout.annotation(name)
    record = read_json(path, AGAIN)

    def field(key: str, wanted: str, read: Callable[[], T]) -> T:
        try:
            return read()
        except (LookupError, TypeError, ValueError, OverflowError, AttributeError) as error:
            raise InputError(f"{path}: field {key!r} must hold {wanted}; {AGAIN}") from error

    instance = field("instances", "one instance", lambda: _only(record["instances"]))
    thing = field("urdf_id", "the object's id", lambda: str(instance["urdf_id"]))
    box = field("bbox", "x1, y1, x2, y2 with x1 < x2 and y1 < y2", lambda: _box(instance["bbox"]))
    depth = field("depth_path", "the depth image", lambda: str(record["depth_path"]))
    links = field("links", f"the links 0 to {parts - 1}", lambda: _links(instance["links"], parts))
    rigid = "a rigid 4x4 matrix of each link"
    T_camera_base, *_ = field("transformation", rigid, lambda: [_rigid(link["transformation"]) for link in links])
    numbers = "a number of each link but the base"
    states = field("state", numbers, lambda: _finite([link["state"] for link in links[1:]], parts - 1).tolist())
    if Path(depth).anchor or ".." in Path(depth).parts:  # on Windows "/x" and "C:x" are not absolute, and elsewhere
        raise InputError(f"{path}: field 'depth_path' leaves the folder of the images; {AGAIN}")
    mask = depth.replace("depth", "category_mask")
    return Annotation(path, thing, box, layout.images / depth, layout.images / mask, T_camera_base, states)


def _only(instances: list[Any]) -> dict[str, Any]:
    (instance,) = instances
    return instance


def _box(values: list[float]) -> tuple[int, int, int, int]:
    x1, y1, x2, y2 = (int(value) for value in Shape(4).array(values))
    if not (0 <= x1 < x2 and 0 <= y1 < y2):
        raise ValueError
    return x1, y1, x2, y2


def _links(links: list[dict[str, Any]], parts: int) -> list[dict[str, Any]]:
    """In the order of their numbers."""
    if sorted(link["link_category_id"] for link in links) != list(range(parts)):
        raise ValueError
    return sorted(links, key=lambda link: link["link_category_id"])


def _rigid(values: Any) -> np.ndarray:
    matrix = _finite(values, 4, 4)
    R = matrix[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > RIGID or np.linalg.det(R) < 0:
        raise ValueError
    return matrix


def _finite(values: Any, *shape: int) -> np.ndarray:
    return Shape(*shape).array(values)
