"""The references are complete: of the command line what the commands say, of Python every public name and field."""

import dataclasses
import importlib
import inspect
import re
import sys
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

import omad

DOCS = Path(__file__).parents[2] / "docs"
LISTED = re.findall(r"^\.\. auto(class|function):: ([\w.]+)$", (DOCS / "api.md").read_text(), re.M)
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
