"""Plain values, as JSON and TOML give them, read as dataclasses whose annotations say what each field must be."""

import difflib
import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import MISSING, dataclass, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

LARGEST = 1e9
"""No number of an array is larger: no place, angle or length that means anything is."""


@dataclass(frozen=True)
class Within:
    """The range of a number: ``Annotated[int, Within(1, 64)]``; the ends belong to it."""

    low: float
    high: float

    def __str__(self) -> str:
        return f"a number from {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Shape:
    """The shape of an array: ``Annotated[np.ndarray, Shape(None, 3)]``; None: any number of them."""

    sides: tuple[int | None, ...]

    def __init__(self, *sides: int | None) -> None:
        object.__setattr__(self, "sides", sides)

    def __str__(self) -> str:
        sides = ", ".join("N" if side is None else str(side) for side in self.sides)
        return f"finite numbers of shape ({sides})"

    def array(self, value: Any) -> np.ndarray:
        """(...) float64 of nested lists. Raises ValueError for another shape, and what is not finite."""
        try:
            found = np.array(value, dtype=np.float64)
            same = len(found.shape) == len(self.sides)
            fits = same and all(want in (None, has) for want, has in zip(self.sides, found.shape, strict=True))
            if fits and (np.abs(found) <= LARGEST).all():
                return found
        except (ValueError, TypeError, OverflowError):
            pass
        raise _wrong(Annotated[np.ndarray, self], value)


def decode(kind: Any, value: Any) -> Any:
    """``value`` as a ``kind``: a dataclass from a table, a tuple from a list, a dict with texts for names, a Literal,
    float, int, str, bool, or a union of such and None; Any is taken as it is. In ``Annotated[kind, "a direction"]`` the
    text says what to give instead of a wrong value; ``Within`` there gives a number's range, ``Shape`` an array's.

    Raises ValueError for what is missing, unknown or wrong, with the field and the cure, as in "parts[1].keypoints: is
    2.5; give a whole number". A dataclass adds what only it can know: a ValueError that its ``__post_init__`` raises is
    to begin with the field, which is completed here."""
    origin, options = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if is_dataclass(kind):
        return _table(kind, value)
    if origin is Annotated:
        if isinstance(options[1], Shape):
            return options[1].array(value)
        try:
            found = decode(options[0], value)
        except ValueError:
            raise _wrong(kind, value) from None
        if isinstance(options[1], Within) and not options[1].low <= found <= options[1].high:
            raise _wrong(kind, value)
        return found
    if origin in (Union, UnionType):
        *others, last = [each for each in options if each is not NoneType]
        if value is None and NoneType in options:
            return None
        for each in others:
            with suppress(ValueError):
                return decode(each, value)
        return decode(last, value)
    if origin is tuple and isinstance(value, list | tuple):
        kinds = [options[0]] * len(value) if options[-1] is ... else options
        if len(kinds) == len(value):
            return tuple(_inside(f"[{index}].", *each) for index, each in enumerate(zip(kinds, value, strict=True)))
    if origin is dict and isinstance(value, dict):
        return {decode(str, name): _inside(f"{name!r}.", options[1], each) for name, each in value.items()}
    if origin is Literal and type(value) in map(type, options) and value in options:
        return value
    if kind is float and isinstance(value, int | float) and type(value) is not bool:
        with suppress(OverflowError):
            if math.isfinite(number := float(value)):
                return number
    if kind in (int, str, bool) and type(value) is kind:
        return value
    raise _wrong(kind, value)


@contextmanager
def within(place: str) -> Iterator[None]:
    """Complete the fields that ValueErrors begin with by ``place``: a prefix such as ``parts[1].``."""
    try:
        yield
    except ValueError as error:
        inside = str(error)
        raise ValueError((place.rstrip(".") if inside[:1] in (":", "[") else place) + inside) from error


def _inside(place: str, kind: Any, value: Any) -> Any:
    with within(place):
        return decode(kind, value)


def _table(kind: Any, value: Any) -> Any:
    if not isinstance(value, dict):
        raise _wrong(kind, value)
    kinds = get_type_hints(kind, include_extras=True)
    for name in value:
        if name not in kinds:
            near = difflib.get_close_matches(name, kinds, 1)
            raise ValueError(f"{name}: is unknown; use {near[0] if near else ', '.join(kinds)}")
    found = {}
    for field in fields(kind):
        if field.name in value:
            found[field.name] = _inside(f"{field.name}.", kinds[field.name], value[field.name])
        elif field.default is MISSING and field.default_factory is MISSING:
            raise ValueError(f"{field.name}: is missing; give {_need(kinds[field.name])}")
    return kind(**found)


def _wrong(kind: Any, value: Any) -> ValueError:
    try:
        shown = repr(value)
    except (ValueError, RecursionError):  # too many digits, too deep
        shown = f"a {type(value).__name__}"
    return ValueError(f": is {shown if len(shown) < 60 else f'{shown[:57]}...'}; give {_need(kind)}")


def _need(kind: Any) -> str:
    """What a person is to give."""
    origin, options = get_origin(kind), get_args(kind)
    if is_dataclass(kind):
        return f"a table with {', '.join(field.name for field in fields(kind))}"
    if origin is Annotated:
        return str(options[1])
    if origin is dict:
        return "a table"
    if origin in (Union, UnionType):
        return _need(options[0])
    if origin is Literal:
        return " or ".join(map(str, options))
    if origin is tuple:
        return "a list" if options[-1] is ... else f"a list of {len(options)}"
    return {float: "a number", int: "a whole number", str: "a text in quotes", bool: "true or false"}[kind]
