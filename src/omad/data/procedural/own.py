"""Generators of the user's own: Python files, which are run."""

import runpy
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import existing
from omad.geometry.mesh import Mesh, triangle_normals
from omad.geometry.rigid import box
from omad.objects.category import Category
from omad.objects.model import ObjectModel, diagonal, odd_size

from ..urdf_import.alignment import check_like
from . import Generator
from .shapes import JointedParts

SUFFIX = ".py"
SHORTEST = 1e-6
"""Length of an axis."""
FARTHER = 2 * np.pi
"""Radians beyond the spec's limits: so far turns nothing, but what was given in degrees."""
LEAST_ALONG = 0.7
"""Cosine between an object's axis and the spec's below which it is another one."""


def own_generator(path: Path | str) -> Generator:
    """The function ``generate`` of a file, which is run: name none that you do not trust. It is as those of the shipped
    categories are: ``generate(rng, category, unusual) -> JointedParts``, metres, at rest, base first; all that is
    random comes from ``rng``. It may import what lies beside it, whenever it runs. Raises InputError, as the function
    does, for what is wrong in the file, with its line."""
    path = existing(Path(path), "a generator of objects")
    if (folder := str(path.resolve().parent)) not in sys.path:
        sys.path.append(folder)  # last: what lies there takes nothing's place
    try:
        with redirect_stdout(sys.stderr):  # what it prints is no answer of a command
            make = runpy.run_path(str(path)).get("generate")
    except (Exception, SystemExit) as error:
        raise _blamed(path, error) from error
    if not callable(make):
        raise InputError(f"{path}: has no function generate(rng, category, unusual); write one")

    repeats = False

    def checked(rng: np.random.Generator, category: Category, unusual: np.random.Generator | None) -> JointedParts:
        nonlocal repeats
        before = None if repeats else deepcopy((rng, unusual))
        made = _made(path, make, rng, category, unusual)
        if before is not None:
            again = _made(path, make, before[0], category, before[1])
            repeats = _same(made, again)
            if not repeats:
                raise InputError(f"{path}: generate gives another object for the same rng; draw all from rng")
        return made

    return checked


def check_family(path: Path | str, models: Sequence[ObjectModel], category: Category) -> None:
    """Raises InputError where most of the objects that a generator made lie or move otherwise than the spec says, as in
    another frame or with their parts in another order; odd ones there may be."""
    faults = [fault for model in models if (fault := _unlike(model, category))]
    if len(faults) > len(models) / 2:
        fault, _ = Counter(faults).most_common(1)[0]
        cure = "mend the generator (metres, y up, the front at +z, at rest, the base first), or the spec"
        raise InputError(f"{path}: {len(faults)} of {len(models)} objects are no {category.name}: {fault}; {cure}")


def _unlike(model: ObjectModel, category: Category) -> str | None:
    along = (model.axes * category.axes).sum(1)
    for joint, cosine in zip(category.joints, along, strict=True):
        if cosine < LEAST_ALONG:
            return f"the axis of {joint.name} is {np.degrees(np.arccos(max(cosine, -1))):.0f} degrees off the spec's"
    try:
        check_like(model, category)
    except InputError as error:
        return str(error)
    return None


def _made(
    path: Path,
    make: Callable[..., object],
    rng: np.random.Generator,
    category: Category,
    unusual: np.random.Generator | None,
) -> JointedParts:
    """One object, as it must be."""
    try:
        with redirect_stdout(sys.stderr):
            made = make(rng, category, unusual)
    except (Exception, SystemExit) as error:
        raise _blamed(path, error) from error
    return _fitting(path, made, category)


def _same(one: JointedParts, other: JointedParts) -> bool:
    def numbers(made: JointedParts) -> list[Any]:
        meshes = [array for part in made.parts for array in (part.vertices, part.faces)]
        return [made.pivots, made.axes, made.limits, *meshes]

    return all(map(np.array_equal, numbers(one), numbers(other)))


def _fitting(path: Path, made: object, category: Category) -> JointedParts:
    if not isinstance(made, JointedParts):
        raise InputError(f"{path}: generate gives a {type(made).__name__}; return JointedParts")
    if not isinstance(made.parts, tuple | list) or not all(isinstance(part, Mesh) for part in made.parts):
        raise InputError(f"{path}: generate gives parts that are no Mesh; give a tuple of them, one a part")
    parts = tuple(Mesh(_array(part.vertices), _array(part.faces, None)) for part in made.parts)
    made = replace(made, parts=parts, pivots=_array(made.pivots), axes=_array(made.axes), limits=_array(made.limits))
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
    axes, limits, spec = made.axes, made.limits, category.metric_limits
    return replace(
        made,
        axes=None if axes is None else axes / np.linalg.norm(axes, axis=1)[:, None],
        limits=None if limits is None else limits.clip(spec[:, :1], spec[:, 1:]),  # as those of imported models
    )


def _array(values: Any, dtype: type | None = np.float64) -> Any:
    """Of doubles, or of what there is, where there are any; no numbers are NaN."""
    try:
        return None if values is None else np.array(values, dtype=dtype)  # a copy: it may change its own
    except (TypeError, ValueError):
        return np.array(np.nan)


def _fault(made: JointedParts, category: Category) -> str | None:
    """What of its numbers cannot be, with the cure."""
    for spec, part in zip(category.parts, made.parts, strict=True):
        if fault := _fault_of_mesh(part):
            return fault.format(part=f"the part {spec.name}")
    for field, values in (("pivots", made.pivots), ("axes", made.axes), ("limits", made.limits)):
        if values is not None and not np.isfinite(values).all():
            return f"{field} that are no finite numbers; repair them"
    if made.axes is not None and not (np.linalg.norm(made.axes, axis=1) > SHORTEST).all():
        return "an axis without a direction; give a unit vector"
    if made.limits is not None:
        if not (made.limits[:, 0] < made.limits[:, 1]).all():
            return "limits that are the wrong way round; give the least first"
        spec = category.metric_limits
        beyond = np.abs(made.limits).max(1) - np.abs(spec).max(1)
        if (beyond[list(category.turning)] > FARTHER).any():
            return "limits of many turns; give radians"
        if (np.maximum(made.limits[:, 0], spec[:, 0]) >= np.minimum(made.limits[:, 1], spec[:, 1])).any():
            return "limits that are outside of the spec's; give radians or metres from the rest state"
    odd = odd_size(diagonal(np.stack([box(part.vertices) for part in made.parts])), category)
    return odd and f"an object that {odd}; give metres"


def _fault_of_mesh(mesh: Mesh) -> str | None:
    """The same of one part, which stands as {part} in it."""
    vertices, faces = mesh.vertices, mesh.faces
    if faces is None or not faces.size:
        return "no face of {part}; give it a mesh"
    if vertices is None or vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        return "vertices of {part} that are no finite numbers; repair them, three a vertex"
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        return "faces of {part} that are no triangles; give three whole numbers a face"
    if faces.min() < 0 or faces.max() >= len(vertices):
        return "faces of {part} with vertices that are not there; repair them"
    if not np.linalg.norm(triangle_normals(mesh.triangles), axis=1).any():
        return "faces of {part} without an area; give it a mesh"
    return None


def _blamed(path: Path, error: BaseException) -> InputError:
    """What to say of an error in the file: the last of its lines that took part."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    line = getattr(error, "lineno", None) if isinstance(error, SyntaxError) else (lines or [None])[-1]
    place = f"{path}:{line}" if line else str(path)
    return InputError(f"{place}: {type(error).__name__}: {error}; repair the generator")
