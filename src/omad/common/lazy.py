"""Imports that wait for their first use: a command loads only what it needs, and help is quick."""

import builtins
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any


class _StandIn:
    """Of a module, function or class that is yet to be imported: it can be called, and asked for attributes."""

    def __init__(self, package: str, name: str) -> None:
        self._found = lambda: getattr(__import__(package, fromlist=[name]), name)

    def __getattr__(self, attribute: str) -> Any:
        return getattr(self._found(), attribute)

    def __call__(self, *args: Any, **options: Any) -> Any:
        return self._found()(*args, **options)


@contextmanager
def lazy_imports() -> Iterator[None]:
    """In a block of it, ``from package import name, ...`` binds stand-ins that import on first use. A constant is to
    be asked of its module, as a stand-in is no value."""

    def stand_ins(package: str, scope: Any, local: Any, names: tuple[str, ...], level: int) -> Any:
        return SimpleNamespace(**{name: _StandIn(package, name) for name in names})

    usual, builtins.__import__ = builtins.__import__, stand_ins
    try:
        yield
    finally:
        builtins.__import__ = usual
