"""A category of the user's own, from a file that people write: TOML, or JSON of the same fields.

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

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar, cast, get_args

from .categories import CATEGORIES, Category, JointSpec, PartSpec, ViewRange
from .errors import InputError
from .kinematics import JointType
from .rest_states import REST_RULES

FORMATS = (".toml", ".json")
KEYPOINTS = 12
"""Of a part that does not say how many."""

T = TypeVar("T")
_NAME = re.compile(r"[A-Za-z0-9][\w.-]*")
_DIRECTION = re.compile(r"([+-]?[xyz])+")
_TOP = {"name", "metres_per_unit", "parts", "views", "basis_size", "swap_symmetry", "source_names"}
_PART = {"name", "keypoints", "mirror", "aliases", "sides", "joint"}
_JOINT = {"name", "type", "parent", "axis", "limits", "reach", "side", "rest"}
_VIEWS = {"azimuth", "elevation", "roll"}


def get_category(name: str | Path) -> Category:
    """The built-in category called ``name``, or the one that the spec file of that path describes.

    Raises InputError for an unknown name, and for a file that is missing or wrong.
    """
    if is_spec_file(name):
        return read_spec(name)
    if str(name) not in CATEGORIES:
        known = ", ".join(sorted(CATEGORIES))
        raise InputError(f"unknown category {str(name)!r}: known ones are {known}; give the spec file of your own one")
    return CATEGORIES[str(name)]


def is_spec_file(name: str | Path) -> bool:
    """Whether ``name`` means a file: by its extension."""
    return Path(name).suffix.lower() in FORMATS


def read_spec(path: str | Path) -> Category:
    """Read a spec file. Raises InputError, one line that names file, field and cure, for whatever is wrong in it."""
    path = Path(path)
    top = _Table(path, "", _parsed(path), _TOP)
    parts = top.tables("parts", _PART)
    names = [part.name() for part in parts]
    for part, name in zip(parts, names, strict=True):
        if names.count(name) > 1:
            part.refuse("name", f"two parts are called {name!r}; rename one")
    joints = [part.table("joint", _JOINT) for part in parts[1:]]
    if "joint" in parts[0].values:
        parts[0].refuse("joint", "the first part is the base, which hangs on nothing; remove it or reorder the parts")
    if not joints:
        top.refuse("parts", "needs a base and at least one part that moves")
    metres_per_unit = top.number("metres_per_unit", above=0.0)
    specs = tuple(_joint(joint, index, names, metres_per_unit) for index, joint in enumerate(joints))
    for index, spec in enumerate(specs):
        if spec.name in [other.name for other in specs[:index]]:
            joints[index].refuse("name", f"two joints are called {spec.name!r}; rename one")
    return Category(
        name=_own_name(top),
        metres_per_unit=metres_per_unit,
        parts=_parts(parts, names),
        joints=specs,
        rest=tuple(_rest(joint, spec.type) for joint, spec in zip(joints, specs, strict=True)),
        views=_views(top),
        basis_size=top.whole("basis_size", 10),
        swap_symmetry=_swap(top, len(parts)),
        source_names=top.words("source_names", ()),
    )


def _parsed(path: Path) -> Any:
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a category's spec file, or a built-in category's name")
    try:
        text = path.read_text(encoding="utf-8")
        return json.loads(text) if path.suffix.lower() == ".json" else tomllib.loads(text)
    except (OSError, ValueError) as error:  # decoding errors of text, TOML and JSON are ValueErrors
        raise InputError(f"{path}: cannot be read ({' '.join(str(error).split())}); repair the file") from error


def _own_name(top: _Table) -> str:
    name = top.name()
    if name in CATEGORIES:
        top.refuse("name", f"{name!r} is a built-in category; choose another name")
    return name


def _swap(top: _Table, parts: int) -> bool:
    swap = top.get("swap_symmetry", False, bool, "true or false")
    if swap and parts != 2:
        top.refuse("swap_symmetry", f"is for two parts, not {parts}; remove it")
    return swap


def _parts(tables: Sequence[_Table], names: list[str]) -> tuple[PartSpec, ...]:
    """A mirror image has the same keypoints, and is mirrored back; halves of a part's own need an even number."""
    parts = tuple(_part(table, index, names) for index, table in enumerate(tables))
    for index, (table, part) in enumerate(zip(tables, parts, strict=True)):
        if part.mirror is None:
            continue
        other = parts[part.mirror]
        if other.mirror != index:
            table.refuse("mirror", f"is {other.name!r}, whose own mirror is another one; name them in each other")
        if other.keypoints != part.keypoints:
            table.refuse("keypoints", f"differ from those of its mirror {other.name!r}; make them equal")
        if part.mirror == index and part.keypoints % 2:
            table.refuse("keypoints", f"are {part.keypoints} on a part that is its own mirror; use an even number")
    return parts


def _part(table: _Table, index: int, names: list[str]) -> PartSpec:
    mirror = table.get("mirror", None, str, '"self" or the name of a part')
    if mirror is not None and mirror not in ("self", *names):
        table.refuse("mirror", f'is {mirror!r}; use "self" or the name of a part ({", ".join(names)})')
    return PartSpec(
        name=names[index],
        keypoints=table.whole("keypoints", KEYPOINTS),
        mirror=None if mirror is None else index if mirror == "self" else names.index(mirror),
        aliases=tuple(alias.lower() for alias in table.words("aliases", (names[index],))),
        sides=_sides(table),
    )


def _sides(table: _Table) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None:
    value = table.values.get("sides")
    if value is None:
        return None
    if isinstance(value, list) and len(value) == 3 and all(_is_range(side) and side[0] >= 0 for side in value):
        x, y, z = ((float(low), float(high)) for low, high in value)
        return x, y, z
    table.refuse("sides", f"is {_shown(value)}; give three ranges [least, most], along x, y and z, from 0 to 1")


def _joint(table: _Table, index: int, names: list[str], metres_per_unit: float) -> JointSpec:
    kind = table.choice("type", get_args(JointType))
    parent = table.choice("parent", names[: index + 1], names[0])
    low, high = table.range("limits")
    unit = math.radians(1) if kind == "revolute" else 1 / metres_per_unit
    return JointSpec(
        name=table.name(f"{names[index + 1]}_joint"),
        type=cast(JointType, kind),
        parent=names.index(parent),
        axis=table.direction("axis"),
        limits=(low * unit, high * unit),
        reach=table.direction("reach") if "reach" in table.values else None,
        side=table.direction("side") if "side" in table.values else None,
    )


def _rest(table: _Table, kind: JointType) -> str:
    return table.choice("rest", [rule for known, rule in REST_RULES if known == kind], "closed")


def _views(top: _Table) -> ViewRange:
    usual = ViewRange()
    if "views" not in top.values:
        return usual
    views = top.table("views", _VIEWS)
    low, high = views.range("elevation", tuple(map(math.degrees, usual.elevation)))
    if not -90 <= low <= high <= 90:
        views.refuse("elevation", f"is {low:g} to {high:g}; stay within -90 and 90 degrees")
    return ViewRange(
        azimuth=math.radians(views.number("azimuth", math.degrees(usual.azimuth), above=0.0, most=180.0)),
        elevation=(math.radians(low), math.radians(high)),
        roll=math.radians(views.number("roll", math.degrees(usual.roll), least=0.0, most=180.0)),
    )


@dataclasses.dataclass(frozen=True)
class _Table:
    """A table of the file, whose fields are asked for one by one. Every question may raise InputError."""

    path: Path
    place: str
    """Where it stands: empty, or a prefix of its fields' names such as ``parts[1].``."""
    values: Any
    known: set[str]

    def __post_init__(self) -> None:
        if not isinstance(self.values, dict):
            raise InputError(f"{self.path}: {self.place.rstrip('.') or 'it'} must be a table of fields")
        for field in self.values:
            if field not in self.known:
                near = difflib.get_close_matches(field, self.known, 1)
                self.refuse(field, f"is unknown; use {near[0] if near else ', '.join(sorted(self.known))}")

    def refuse(self, field: str, reason: str) -> NoReturn:
        raise InputError(f"{self.path}: {self.place}{field}: {reason}")

    def get(self, field: str, default: T, kind: type, need: str) -> T:
        """A field of one kind; ``...`` as the default means that it must be there."""
        value = self.values.get(field, default)
        if value is ...:
            self.refuse(field, f"is missing; give {need}")
        if value is not default and not isinstance(value, kind):
            self.refuse(field, f"is {_shown(value)}; give {need}")
        return value

    def number(
        self,
        field: str,
        default: Any = ...,
        above: float = -math.inf,
        least: float = -math.inf,
        most: float = math.inf,
    ) -> float:
        need = "a number" + "".join(
            f" {word} {bound:g}"
            for word, bound in (("above", above), ("from", least), ("up to", most))
            if math.isfinite(bound)
        )
        value = self.values.get(field, default)
        if value is ...:
            self.refuse(field, f"is missing; give {need}")
        if not _is_number(value) or not (value > above and least <= value <= most):
            self.refuse(field, f"is {_shown(value)}; give {need}")
        return float(value)

    def whole(self, field: str, default: int) -> int:
        value = self.values.get(field, default)
        if type(value) is not int or value < 1:
            self.refuse(field, f"is {_shown(value)}; give a whole number from 1")
        return value

    def name(self, default: Any = ...) -> str:
        value = self.get("name", default, str, "a name")
        if not _NAME.fullmatch(value):
            self.refuse("name", f"is {value!r}; use letters, digits, '_', '-' and '.'")
        return value

    def choice(self, field: str, options: Sequence[str], default: Any = ...) -> str:
        value = self.get(field, default, str, " or ".join(options))
        if value not in options:
            self.refuse(field, f"is {value!r}; give {' or '.join(options)}")
        return value

    def words(self, field: str, default: tuple[str, ...]) -> tuple[str, ...]:
        value = self.get(field, list(default), list, "a list of names")
        if not all(isinstance(word, str) and word for word in value):
            self.refuse(field, "must be a list of names in quotes")
        return tuple(value)

    def range(self, field: str, default: Any = ...) -> tuple[float, float]:
        value = self.values.get(field, default)
        need = "two numbers, low and high (degrees, or metres of a slide)"
        if value is ...:
            self.refuse(field, f"is missing; give {need}")
        if not isinstance(value, list | tuple) or len(value) != 2 or not all(map(_is_number, value)):
            self.refuse(field, f"is {_shown(value)}; give {need}")
        if not _is_range(value):
            self.refuse(field, f"is {_shown(value)}; give the low end first, and a range that is not empty")
        return float(value[0]), float(value[1])

    def direction(self, field: str) -> tuple[float, float, float]:
        """Three numbers, or letters such as "+y" and "+y-z"."""
        value = self.values.get(field)
        need = 'a direction: "+x", "-y", "+y-z" or three numbers (x right, y up, z to the front)'
        if value is None:
            self.refuse(field, f"is missing; give {need}")
        if isinstance(value, str) and _DIRECTION.fullmatch(value):
            found = dict.fromkeys("xyz", 0.0)
            for sign, letter in re.findall(r"([+-]?)([xyz])", value):
                found[letter] += -1.0 if sign == "-" else 1.0
            numbers = list(found.values())
        elif isinstance(value, list) and len(value) == 3 and all(map(_is_number, value)):
            numbers = [float(number) for number in value]
        else:
            self.refuse(field, f"is {_shown(value)}; give {need}")
        length = math.hypot(*numbers)
        if length == 0:
            self.refuse(field, f"is {_shown(value)}, which has no direction; give {need}")
        x, y, z = (number / length for number in numbers)
        return x, y, z

    def table(self, field: str, known: set[str]) -> _Table:
        if field not in self.values:
            self.refuse(field, f"is missing; give a table with {', '.join(sorted(known))}")
        return _Table(self.path, f"{self.place}{field}.", self.values[field], known)

    def tables(self, field: str, known: set[str]) -> list[_Table]:
        value = self.values.get(field)
        if not value or not isinstance(value, list):
            self.refuse(field, "must be a list of tables, one a part, the base first")
        return [_Table(self.path, f"{self.place}{field}[{i}].", inner, known) for i, inner in enumerate(value)]


def _is_range(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) == 2 and all(map(_is_number, value)) and value[0] < value[1]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 60 else text[:57] + "..."
