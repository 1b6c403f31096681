"""Generators of the user's own: Python files, which are run."""

import runpy
import traceback
from pathlib import Path

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import existing
from omad.objects.category import Category

from . import Generator
from .shapes import JointedParts

SUFFIX = ".py"


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
    parts, joints = len(category.parts), len(category.joints)
    for field, found, wanted in (
        ("parts", len(made.parts), parts),
        ("pivots", np.shape(made.pivots), (joints, 3)),
        ("axes", None if made.axes is None else np.shape(made.axes), (joints, 3)),
        ("limits", None if made.limits is None else np.shape(made.limits), (joints, 2)),
    ):
        if found not in (None, wanted):
            raise InputError(f"{path}: generate gives {field} of {found}, a {category.name} has {wanted}; repair it")
    return made


def _blamed(path: Path, error: Exception) -> InputError:
    """What to say of an error in the file: the last of its lines that took part."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    line = getattr(error, "lineno", None) if isinstance(error, SyntaxError) else (lines or [None])[-1]
    place = f"{path}:{line}" if line else str(path)
    return InputError(f"{place}: {type(error).__name__}: {error}; repair the generator")
