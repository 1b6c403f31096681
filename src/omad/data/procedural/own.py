"""Generators of the user's own: Python files, which are run."""

import runpy
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import existing
from omad.geometry.mesh import Mesh
from omad.geometry.rigid import box
from omad.objects.category import Category
from omad.objects.model import diagonal, odd_size

from . import Generator
from .shapes import JointedParts

SUFFIX = ".py"
SHORTEST = 1e-6
"""Length of an axis."""
FARTHEST_TURN = 8 * np.pi
"""Radians."""


def own_generator(path: Path | str) -> Generator:
    """The function ``generate`` of a file, which is run: name none that you do not trust. It is as those of the shipped
    categories are: ``generate(rng, category, unusual) -> JointedParts``, metres, at rest, base first; all that is
    random comes from ``rng``. Raises InputError, as the function does, for what is wrong in the file, with its line."""
    path = existing(Path(path), "a generator of objects")
    try:
        make = runpy.run_path(str(path)).get("generate")
    except Exception as error:
        raise _blamed(path, error) from error
    if not callable(make):
        raise InputError(f"{path}: has no function generate(rng, category, unusual); write one")

    def checked(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
        try:
            made = make(rng, category, unusual)
        except Exception as error:
            raise _blamed(path, error) from error
        return _fitting(path, made, category)

    return checked


def _fitting(path: Path, made: object, category: Category) -> JointedParts:
    if not isinstance(made, JointedParts):
        raise InputError(f"{path}: generate gives a {type(made).__name__}; return JointedParts")
    if not all(isinstance(part, Mesh) for part in made.parts):
        raise InputError(f"{path}: generate gives parts that are no Mesh; repair it")
    made = replace(made, pivots=_array(made.pivots), axes=_array(made.axes), limits=_array(made.limits))
    joints = len(category.joints)
    for field, found, wanted in (
        ("parts", len(made.parts), len(category.parts)),
        ("pivots", made.pivots.shape, (joints, 3)),
        ("axes", None if made.axes is None else made.axes.shape, (joints, 3)),
        ("limits", None if made.limits is None else made.limits.shape, (joints, 2)),
    ):
        if found not in (None, wanted):
            raise InputError(f"{path}: generate gives {field} of {found}, a {category.name} has {wanted}; repair it")
    if fault := _fault(made, category):
        raise InputError(f"{path}: generate gives {fault}")
    return made if made.axes is None else replace(made, axes=made.axes / np.linalg.norm(made.axes, axis=1)[:, None])


def _array(values: Any) -> Any:
    """Of doubles, where there are any; no numbers are NaN."""
    try:
        return None if values is None else np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        return np.array(np.nan)


def _fault(made: JointedParts, category: Category) -> str | None:
    """What of its numbers cannot be, with the cure."""
    for spec, part in zip(category.parts, made.parts, strict=True):
        if not len(part.faces):
            return f"no face of the part {spec.name}; give it a mesh"
        if not np.isfinite(part.vertices).all():
            return f"vertices of the part {spec.name} that are no finite numbers; repair them"
    for field, values in (("pivots", made.pivots), ("axes", made.axes), ("limits", made.limits)):
        if values is not None and not np.isfinite(values).all():
            return f"{field} that are no finite numbers; repair them"
    if made.axes is not None and not (np.linalg.norm(made.axes, axis=1) > SHORTEST).all():
        return "an axis without a direction; give a unit vector"
    if made.limits is not None:
        if not (made.limits[:, 0] < made.limits[:, 1]).all():
            return "limits that are the wrong way round; give the least first"
        if (np.abs(made.limits[list(category.turning)]) > FARTHEST_TURN).any():
            return "limits of many turns; give radians"
    odd = odd_size(diagonal(np.stack([box(part.vertices) for part in made.parts])), category)
    return odd and f"an object that {odd}; give metres"


def _blamed(path: Path, error: Exception) -> InputError:
    """What to say of an error in the file: the last of its lines that took part."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    line = getattr(error, "lineno", None) if isinstance(error, SyntaxError) else (lines or [None])[-1]
    place = f"{path}:{line}" if line else str(path)
    return InputError(f"{place}: {type(error).__name__}: {error}; repair the generator")
