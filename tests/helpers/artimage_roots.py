"""What is written in ArtImage's layout, and how it is broken."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from omad.data.artimage.layout import Split
from omad.data.procedural import generate
from omad.objects.category import Category
from omad.objects.model import ObjectModel


def objects(category: Category, count: int = 2, split: Split = "test") -> list[ObjectModel]:
    return [generate(category, index, split) for index in range(count)]


def edit(path: Path, change: Callable[[dict], object]) -> None:
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
