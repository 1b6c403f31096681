"""The references are complete: of the command line what the commands say, of Python every public name and field."""

import dataclasses
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
import torch

import omad

DOCS = Path(__file__).parents[2] / "docs"
API, _, INSIDE = (DOCS / "api.md").read_text().partition("\n## Inside\n")
PUBLIC, INNER = (re.findall(r"^\.\. auto(class|function):: ([\w.]+)$", text, re.M) for text in (API, INSIDE))
LISTED = PUBLIC + INNER
CLASSES = [name for kind, name in LISTED if kind == "class"]


@pytest.fixture(autouse=True)
def with_the_docs_own_scripts(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(DOCS), *sys.path])


def found(name: str) -> Any:
    module, _, member = name.rpartition(".")
    return getattr(importlib.import_module(module), member)


def test_the_page_of_commands_is_what_the_commands_say():
    make_cli = importlib.import_module("make_cli")
    assert (DOCS / "cli.md").read_text() == make_cli.page(), "run python docs/make_cli.py"


def test_every_option_is_explained():
    for line in (DOCS / "cli.md").read_text().splitlines():
        assert not line.startswith("| `") or line.rstrip(" |").count("|") >= 3, line


def test_every_public_name_is_on_the_page():
    listed = {name for _, name in LISTED}
    homes = {f"omad.{home}.{name}" for name, home in omad._HOMES.items()}
    assert homes <= listed
    assert {*omad.__all__} <= {*dir(omad)}


def own_types(hint: Any) -> set[type]:
    """Of a hint all classes of omad's, within containers, unions and functions' arguments, too."""
    inner = hint if isinstance(hint, list) else get_args(hint)
    if not inner and isinstance(hint, type) and hint.__module__.startswith("omad."):
        return {hint}
    return set().union(*map(own_types, inner))


def asked_of(listed: Any) -> Iterator[Any]:
    """What has hints that a user reads: a function; a class's fields, public methods and properties, also those of the
    classes above it, and what makes it, where that is explained."""
    if not inspect.isclass(listed):
        yield listed
        return
    for kind in listed.__mro__:
        if not kind.__module__.startswith("omad."):
            continue
        if dataclasses.is_dataclass(kind):
            yield kind
        elif "__init__" in vars(kind) and kind.__init__.__doc__ not in (None, object.__init__.__doc__):
            yield vars(kind)["__init__"]
        for name, value in vars(kind).items():
            value = next((call for at in ("fget", "func", "__func__") if (call := getattr(value, at, None))), value)
            if inspect.isfunction(value) and (name == "__call__" or not name.startswith("_")):
                yield value


@pytest.mark.parametrize("name", [name for _, name in PUBLIC])
def test_classes_that_signatures_name_are_on_the_page(name):
    kinds = {found(one) for _, one in LISTED}
    for asked in asked_of(found(name)):
        for field, hint in get_type_hints(asked).items():
            missing = {kind.__qualname__ for kind in own_types(hint) - kinds if not field.startswith("_")}
            assert not missing, f"{asked.__qualname__}: {field}"


@pytest.mark.parametrize("name", CLASSES)
def test_what_holds_arrays_is_compared_by_identity(name):
    """Otherwise ``==`` and ``in`` would ask an array whether it is true."""
    kind = found(name)
    hints = get_type_hints(kind) if dataclasses.is_dataclass(kind) else {}
    if any(each in (np.ndarray, torch.Tensor) for hint in hints.values() for each in (hint, *get_args(hint))):
        assert kind.__eq__ is object.__eq__


@pytest.mark.parametrize("name", [name for _, name in LISTED])
def test_what_is_listed_is_there_and_explained(name):
    assert inspect.getdoc(found(name))


@pytest.mark.parametrize("name", CLASSES)
def test_every_public_field_and_method_is_explained(name):
    kind = found(name)
    told = importlib.import_module("make_cli").descriptions(kind) if dataclasses.is_dataclass(kind) else {}
    fields = [field.name for field in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else []
    missing = [field for field in fields if not field.startswith("_") and field not in told]
    for member, value in vars(kind).items():
        call = value.func if isinstance(value, cached_property) else getattr(value, "fget", value)
        public = not member.startswith("_") and member not in fields and callable(getattr(call, "__func__", call))
        if public and not (inspect.getdoc(getattr(kind, member, None)) or inspect.getdoc(call)):
            missing.append(member)
    assert not missing
