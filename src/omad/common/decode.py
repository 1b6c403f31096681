"""Plain values, as JSON and TOML give them, read as dataclasses whose annotations say what each field must be."""

import difflib
import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints


def decode(kind: Any, value: Any) -> Any:
    """``value`` as a ``kind``: a dataclass from a table, a tuple from a list, a Literal, float, int, str, bool, or a
    union of such and None. In ``Annotated[kind, "a direction"]`` the text says what to give instead of a wrong value.
    Raises ValueError for what is missing, unknown or wrong, with the field and the cure, as in "parts[1].keypoints: is
    2.5; give a whole number". A dataclass adds what only it can know: a ValueError that its ``__post_init__`` raises is
    to begin with the field, which is completed here."""
    origin, options = get_origin(kind), get_args(kind)
    if is_dataclass(kind):
        return _table(kind, value)
    if origin is Annotated:
        try:
            return decode(options[0], value)
        except ValueError:
            raise _wrong(kind, value) from None
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
    if origin is Literal and value in options:
        return value
    if kind is float and isinstance(value, int | float) and type(value) is not bool and math.isfinite(value):
        return float(value)
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
    shown = repr(value)
    return ValueError(f": is {shown if len(shown) < 60 else f'{shown[:57]}...'}; give {_need(kind)}")


def _need(kind: Any) -> str:
    """What a person is to give."""
    origin, options = get_origin(kind), get_args(kind)
    if is_dataclass(kind):
        return f"a table with {', '.join(field.name for field in fields(kind))}"
    if origin is Annotated:
        return options[1]
    if origin in (Union, UnionType):
        return _need(options[0])
    if origin is Literal:
        return " or ".join(map(str, options))
    if origin is tuple:
        return "a list" if options[-1] is ... else f"a list of {len(options)}"
    return {float: "a number", int: "a whole number", str: "a text in quotes", bool: "true or false"}[kind]
