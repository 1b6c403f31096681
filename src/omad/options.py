"""Options that many commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import tyro

from .categories import CATEGORIES, Category
from .errors import InputError
from .sources.artimage import Broken
from .spec_file import is_spec_file, read_spec

CategoryName = Annotated[
    str,
    tyro.conf.arg(help=f"{', '.join(CATEGORIES)}; or your own: a spec file (.toml, .json), or the name in --weights."),
]
Seed = Annotated[int, tyro.conf.arg(help="Another seed, other random choices.")]
Json = Annotated[bool, tyro.conf.arg(help="Print one JSON object on stdout and nothing else there.")]
Device = Annotated[str, tyro.conf.arg(help="cpu, cuda, or auto: CUDA where there is one.")]
Weights = Annotated[Path | None, tyro.conf.arg(help="Checkpoint folder in place of the shipped weights.")]
BrokenFiles = Annotated[
    Broken,
    tyro.conf.arg(help="Broken files of an ArtImage root: refuse the root, or skip what they belong to and list it."),
]
Result = tuple[int, dict[str, Any]]


def check_positive(**options: float | None) -> None:
    """Raises InputError for an option that is not above zero; None is an option that was not given."""
    for name, value in options.items():
        if value is not None and not 0 < value < math.inf:
            need = "at least 1" if isinstance(value, int) else "a number above 0"
            raise InputError(f"--{name.replace('_', '-')} {value}: must be {need}")


def check_category(option: str, folder: Path | None, found: Category, wanted: str) -> None:
    """Raises InputError where the checkpoint ``folder`` given with ``option`` is of another category than wanted: of
    another name, or trained with a spec file whose parts and joints were others."""
    spec = read_spec(wanted) if is_spec_file(wanted) else None
    name = spec.name if spec else wanted
    if found.name != name:
        raise InputError(f"{option} {folder}: is for {found.name}, not for {name}; change it or --category")
    if spec and _learned(spec) != _learned(found):
        raise InputError(f"{wanted}: parts or joints changed since {option} {folder} was trained; train it anew")


def _learned(category: Category) -> tuple[Any, ...]:
    """What a checkpoint cannot do without: where this changes, its numbers mean something else."""
    parts = [(part.name, part.keypoints, part.mirror) for part in category.parts]
    joints = [(joint.type, joint.parent, joint.axis) for joint in category.joints]
    return category.metres_per_unit, category.basis_size, parts, joints, category.rest
