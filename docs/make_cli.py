"""Writes docs/cli.md, the reference of the command line, from the commands themselves: ``python docs/make_cli.py``."""

import ast
import dataclasses
import inspect
import textwrap
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

from omad.cli.main import ABOUT, COMMANDS, Group

FILE = Path(__file__).with_name("cli.md")
HEAD = f"""# Command line

{ABOUT} `omad COMMAND --help` says the same as this page, which is made from the commands (`python docs/make_cli.py`).
Options without a default are needed.
"""
KINDS = {Path: "PATH", str: "TEXT", int: "N", float: "NUMBER"}


@dataclasses.dataclass(frozen=True)
class Option:
    """A row of a command's table."""

    name: str
    values: str
    default: str
    about: str

    @property
    def row(self) -> str:
        cells = (f"`{self.name}{' ' + self.values if self.values else ''}`", self.default, self.about)
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def page() -> str:
    """The whole page."""
    sections = [HEAD]
    for name, command in COMMANDS.items():
        if isinstance(command, Group):
            sections.append(f"## omad {name}\n\n{command.about}\n")
            sections += [section(f"omad {name} {part}", kind, "###") for part, kind in command.commands.items()]
        else:
            sections.append(section(f"omad {name}", command, "##"))
    return "\n".join(sections)


def section(name: str, command: type, mark: str) -> str:
    """A command: what it does, and a table of its options."""
    rows = [option.row for option in options(command)]
    table = ["| option | default | |", "|---|---|---|", *rows]
    return "\n".join([f"{mark} {name}", "", inspect.cleandoc(command.__doc__ or ""), "", *table, ""])


def options(command: type, preset: Any = None) -> Iterator[Option]:
    """Of a command, in its order; ``preset``: an instance whose values are the defaults."""
    hints, told = get_type_hints(command, include_extras=True), descriptions(command)
    for field in dataclasses.fields(command):
        kind, marks = bare(hints[field.name])
        default = getattr(preset, field.name) if preset is not None else field.default
        if dataclasses.is_dataclass(kind):
            yield from options(kind, default)
            continue
        about = next((mark.help for mark in marks if getattr(mark, "help", None)), None) or told.get(field.name, "")
        positional = tyro.conf.Positional[int].__metadata__[0] in marks
        name = field.name.upper() if positional else f"--{field.name.replace('_', '-')}"
        if kind is bool:
            yield Option(f"{name}, --no-{name[2:]}" if default else name, "", "on" if default else "off", about)
        else:
            yield Option(name, "" if positional else shown_type(kind), shown_default(default), about)


def bare(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without its annotations and without None, and the annotations."""
    marks: tuple[Any, ...] = ()
    while True:
        if get_origin(hint) is Annotated:
            hint, *more = get_args(hint)
            marks += tuple(more)
        elif get_origin(hint) in (Union, types.UnionType):
            [hint] = [inner for inner in get_args(hint) if inner is not type(None)]
        else:
            return hint, marks


def shown_type(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return "|".join(map(str, get_args(kind)))
    if get_origin(kind) is tuple:
        return f"{shown_type(get_args(kind)[0])} ..."
    return KINDS.get(kind, "TEXT")


def shown_default(default: Any) -> str:
    if default is dataclasses.MISSING:
        return ""
    return "-" if default in (None, ()) else f"`{default}`"


def descriptions(command: type) -> dict[str, str]:
    """The text under each field, its own class's before those that it inherits."""
    found: dict[str, str] = {}
    for owner in reversed(command.__mro__[:-1]):
        [definition] = ast.parse(textwrap.dedent(inspect.getsource(owner))).body
        assert isinstance(definition, ast.ClassDef)
        for one, after in zip(definition.body, definition.body[1:], strict=False):
            text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and after.value.value
            if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name) and isinstance(text, str):
                found[one.target.id] = " ".join(text.split())
    return found


if __name__ == "__main__":
    FILE.write_text(page())
