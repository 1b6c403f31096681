"""Roots in ArtImage's layout."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers.artimage_roots import objects
from helpers.categories import LAPTOP
from omad.data.artimage import write_artimage
from omad.data.artimage.layout import Layout
from omad.objects.category import Category


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Category], Path]:
    """A root with two test objects, two views each, of a category; written once, only to be read."""
    root = tmp_path_factory.mktemp("artimage")

    def write(category: Category) -> Path:
        if not (root / category.name).exists():
            write_artimage(objects(category), category, root, 4, "test")
        return root

    return write


@pytest.fixture
def laptops(written: Callable[[Category], Path], tmp_path: Path) -> Layout:
    """A copy of the laptops to break."""
    shutil.copytree(written(LAPTOP), tmp_path / "root")
    return Layout(tmp_path / "root", "laptop")
