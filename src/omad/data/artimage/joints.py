"""Joints of an ArtImage object, from its URDFs: a triple "x y z" of theirs means (y, z, x)."""

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from omad.common.errors import InputError
from omad.common.incoming import read_bytes, readable
from omad.geometry.joint_kinds import PRISMATIC, type_of
from omad.geometry.rigid import rigid
from omad.objects.category import Category

from .layout import AGAIN, Layout


@dataclass(frozen=True)
class FileJoint:
    """The joint of one child part; axes permuted to ours, lengths in the file's units."""

    part: int
    turns: bool
    """Whether it turns about its axis; if not, it slides along it."""
    axis: np.ndarray
    pivot: np.ndarray
    limits: tuple[float, float] | None
    """Degrees or units, zero at rest."""


def read_joints(path: Path, category: Category) -> list[FileJoint]:
    """The joint of every child part, by number."""
    found: dict[int, FileJoint] = {}
    for element in _parse(path).iter("joint"):
        name, kind = element.get("name", ""), element.get("type")
        if kind == "fixed":
            continue
        try:
            part = int(name.rsplit("_", 1)[1])
            limit = element.find("limit")
            limits = None if limit is None else (float(limit.get("lower", "nan")), float(limit.get("upper", "nan")))
            direction, pivot = (_triple(element.find(tag), "xyz")[[1, 2, 0]] for tag in ("axis", "origin"))
            length = np.linalg.norm(direction)
            if not length > 0:
                raise ValueError("its axis has no direction")
        except (ValueError, IndexError) as error:
            expected = "expected a name that ends in _<part>, an origin and an axis"
            raise InputError(f"{path}: joint {name!r} is not readable ({error}); {expected}") from error
        found[part] = FileJoint(part, kind != type_of(PRISMATIC), direction / length, pivot, limits)
    moved, wanted = sorted(found), list(range(1, len(category.parts)))
    if moved != wanted:
        raise InputError(f"{path}: moves the parts {moved}, those of a {category.name} are {wanted}; leave it out")
    return [found[part] for part in wanted]


def _parse(path: Path) -> ElementTree.Element:
    if not path.is_file():
        raise InputError(f"{path}: missing; {AGAIN}")
    with readable(path, "XML", AGAIN):
        return ElementTree.fromstring(read_bytes(path, "text_bytes"))


def _triple(element: ElementTree.Element | None, key: str) -> np.ndarray:
    """(3,); an origin that is not written is zero."""
    values = np.array([float(word) for word in ("0 0 0" if element is None else element.get(key, "0 0 0")).split()])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError(f"{key} needs three finite numbers")
    return values


def read_base_offset(layout: Layout, name: str) -> np.ndarray:
    """(4, 4) how the origin of joint_0 moved between the plain and the aligned URDF; in the file's units."""
    origins = []
    for path in (layout.plain_urdf(name), layout.aligned_urdf(name)):
        origin = _parse(path).find("joint[@name='joint_0']/origin")
        if origin is None:
            raise InputError(f"{path}: no origin of joint_0; {AGAIN}")
        try:
            (x, y, z), (r, p, w) = _triple(origin, "xyz"), _triple(origin, "rpy")
        except ValueError as error:
            raise InputError(f"{path}: the origin of joint_0 is not readable ({error}); {AGAIN}") from error
        origins.append([-x, z, -y, -r, w, -p])
    moved = np.subtract(origins[1], origins[0])
    return rigid(Rotation.from_euler("ZXY", moved[3:]).as_matrix(), moved[:3])
