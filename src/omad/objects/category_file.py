"""The spec file of a category, a shipped one or one of the user's own: TOML, or JSON of the same fields.

    name = "microwave"
    metres_per_unit = 0.3

    [[parts]]
    name = "body"

    [[parts]]
    name = "door"
    joint = { type = "revolute", axis = "-y", limits = [0, 90], reach = "+x", side = "+z" }

Angles are in degrees, lengths in metres. Every part but the first, which is the base, hangs on another one by its
joint. `docs/own-category.md` explains the fields.
"""

import math
import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from omad.common.decode import decode, within
from omad.common.errors import InputError, unknown
from omad.common.incoming import existing, read_json, read_toml
from omad.geometry.joint_kinds import JointType

from .builtin import FOLDER, builtin_names
from .category import Category, JointSpec, PartSpec, RestRule, ViewRange, check_unit

FARTHEST_SLIDE = 30.0
"""Category units; beyond are lengths in another unit."""
_Vector = tuple[float, float, float]
_NEED_DIRECTION = 'a direction: "+x", "-y", "+y-z" or three numbers (x right, y up, z to the front)'
_Direction = Annotated[str | _Vector, _NEED_DIRECTION]
_Limits = Annotated[tuple[float, float], "two numbers, low and high (degrees, or metres of a slide)"]
_Range = tuple[float, float]
_Sides = Annotated[tuple[_Range, _Range, _Range], "three ranges [least, most], along x, y and z, from 0 to 1"]


@dataclass(frozen=True)
class _Joint:
    type: JointType
    axis: _Direction
    limits: _Limits
    name: str | None = None
    parent: str | None = None
    reach: _Direction | None = None
    side: _Direction | None = None
    rest: RestRule = JointSpec.rest
    pitch: Annotated[float, "metres a turn"] | None = None
    at_most: str | None = None


@dataclass(frozen=True)
class _Part:
    name: str
    keypoints: int = 12
    mirror: str | None = None
    aliases: tuple[str, ...] | None = None
    sides: _Sides | None = None
    joint: _Joint | None = None


@dataclass(frozen=True)
class _Views:
    """In degrees."""

    azimuth: float | None = None
    elevation: _Range | None = None
    roll: float | None = None

    def __post_init__(self) -> None:
        low, high = self.elevation or (0.0, 0.0)
        if low != high and max(abs(low), abs(high)) <= math.pi / 2:
            meant = f"[{math.degrees(low):.0f}, {math.degrees(high):.0f}]"
            raise ValueError(
                f"elevation: are degrees, and [{low:g}, {high:g}] hardly a range; of radians, give {meant}"
            )
        if self.azimuth is not None and 0 < self.azimuth <= math.pi:
            meant = f"{math.degrees(self.azimuth):.0f}"
            raise ValueError(f"azimuth: is {self.azimuth:g} degrees, hardly any; of radians, give {meant}")


@dataclass(frozen=True)
class _File:
    name: str
    metres_per_unit: Annotated[float, "a number above 0"]
    parts: tuple[_Part, ...]
    views: _Views = _Views()
    basis_size: int = Category.basis_size
    swap_symmetry: bool = Category.swap_symmetry
    either_hand: bool = Category.either_hand
    source_names: tuple[str, ...] = Category.source_names


def _check_name(name: str) -> None:
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", name):
        raise ValueError(f"name: is {name!r}; use letters, digits, '_', '-' and '.'")


def get_category(name: str | Path) -> Category:
    """The built-in category called ``name``, or the one that the spec file of that path describes. Raises InputError
    for an unknown name, and for a file that is missing or wrong."""
    if is_spec_file(name):
        return read_spec(name)
    if str(name) not in builtin_names():
        known = builtin_names()
        raise InputError(
            f"unknown category {unknown(str(name), known)}: known ones are {', '.join(known)}; give the spec file of "
            "your own one"
        )
    return _builtin(str(name))


def is_spec_file(name: str | Path) -> bool:
    """Whether ``name`` means a file: by its extension."""
    return Path(str(name)).suffix.lower() in (".toml", ".json")


def read_spec(path: str | Path) -> Category:
    """Read a spec file. Raises InputError, one line that names file, field and cure, for whatever is wrong in it."""
    category = _read(Path(path))
    if category.name in builtin_names():
        raise InputError(f"{path}: name: {category.name!r} is a built-in category; choose another name")
    return category


@cache
def _builtin(name: str) -> Category:
    return _read(FOLDER / f"{name}.toml")


def _read(path: Path) -> Category:
    cure = "repair the file"
    path = existing(path, "a category's spec file, or a built-in category's name")
    values = read_json(path, cure) if path.suffix.lower() == ".json" else read_toml(path, cure)
    try:
        return _category(decode(_File, values))
    except ValueError as error:
        raise InputError(f"{path}: {str(error).removeprefix(': ')}") from error


def _category(file: _File) -> Category:
    _check_name(file.name)
    check_unit(file.metres_per_unit)
    names = [part.name for part in file.parts]
    parts: list[PartSpec] = []
    joints: list[JointSpec] = []
    for index, table in enumerate(file.parts):
        with within(f"parts[{index}]."):
            _check_name(table.name)
            parts.append(_part(table, index, names))
            if index == 0 and table.joint:
                raise ValueError("joint: the first part is the base, which hangs on nothing; remove it")
            if index > 0 and not table.joint:
                raise ValueError("joint: is missing; only the first part hangs on none")
        if table.joint:
            with within(f"parts[{index}].joint."):
                joints.append(_joint(table.joint, index, names, joints, file.metres_per_unit))
    with within("views."):
        views = ViewRange(**{field: _radians(value) for field, value in vars(file.views).items() if value is not None})
    return Category(**vars(file) | {"parts": tuple(parts), "joints": tuple(joints), "views": views})


def _radians(degrees: Any) -> Any:
    """Of a number, or of each of several."""
    return tuple(map(math.radians, degrees)) if isinstance(degrees, tuple) else math.radians(degrees)


def _part(table: _Part, index: int, names: list[str]) -> PartSpec:
    if table.mirror not in (None, "self", *names):
        raise ValueError(f'mirror: is {table.mirror!r}; use "self" or the name of a part ({", ".join(names)})')
    mirror = index if table.mirror == "self" else names.index(table.mirror) if table.mirror else None
    aliases = (table.name,) if table.aliases is None else table.aliases
    return PartSpec(table.name, table.keypoints, mirror, tuple(alias.lower() for alias in aliases), table.sides)


def _joint(table: _Joint, index: int, names: list[str], before: list[JointSpec], metres_per_unit: float) -> JointSpec:
    """The joint of the part ``index``; ``before`` are those of the parts before it."""
    name = f"{names[index]}_joint" if table.name is None else table.name
    _check_name(name)
    parent = names[0] if table.parent is None else table.parent
    if parent not in names[:index]:
        raise ValueError(f"parent: is {parent!r}; give {' or '.join(names[:index])}")
    others = [joint.name for joint in before]
    if table.at_most not in (None, *others):
        raise ValueError(
            f"at_most: is {table.at_most!r}; give {' or '.join(others) or 'none, as no joint is before it'}"
        )
    at_most = None if table.at_most is None else others.index(table.at_most)
    found = {field: _vector(field, getattr(table, field)) for field in ("axis", "reach", "side")}
    length = math.hypot(*found["axis"]) or 1.0
    found["axis"] = tuple(x / length for x in found["axis"])
    spec = JointSpec(**vars(table) | found | {"name": name, "parent": names.index(parent), "at_most": at_most})
    if spec.reach and not np.cross(spec.axis, spec.reach).any():
        raise ValueError("reach: is along the axis; give where from the axis the part lies, or leave it out")
    if spec.motion.turns and max(map(abs, spec.limits)) <= 2 * math.pi:
        raise ValueError(
            f"limits: are degrees, and {spec.limits} hardly a movement; of radians, give {_in_degrees(spec)}"
        )
    if not spec.motion.turns and max(map(abs, spec.limits)) > FARTHEST_SLIDE * metres_per_unit:
        cm, mm = ([end / factor for end in spec.limits] for factor in (100, 1000))
        raise ValueError(
            f"limits: are metres, and {spec.limits} too far for metres_per_unit {metres_per_unit:g}; "
            f"of centimetres, give {cm}, of millimetres {mm}"
        )
    unit = math.radians(1) if spec.motion.turns else 1 / metres_per_unit
    return replace(spec, limits=tuple(end * unit for end in table.limits))


def _in_degrees(spec: JointSpec) -> str:
    return "[{:.0f}, {:.0f}]".format(*map(math.degrees, spec.limits))


def _vector(field: str, value: Any) -> Any:
    """Three numbers, or None, as they are; letters such as "+y" and "+y-z" summed up."""
    if not isinstance(value, str):
        return value
    if not re.fullmatch(r"([+-]?[xyz])+", value):
        raise ValueError(f"{field}: is {value!r}; give {_NEED_DIRECTION}")
    terms = [(letter, -1.0 if sign == "-" else 1.0) for sign, letter in re.findall(r"([+-]?)([xyz])", value)]
    return tuple(sum((step for letter, step in terms if letter == axis), 0.0) for axis in "xyz")
