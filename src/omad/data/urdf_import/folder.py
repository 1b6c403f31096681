"""Object models from folders of URDFs: plain ones in metres, and PartNet-Mobility's normalised ones."""

import math
import os
import shlex
from collections import Counter
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from omad.common.errors import InputError
from omad.common.incoming import as_path, is_file, read_json, readable
from omad.objects.builtin import builtin_names
from omad.objects.category import Category
from omad.objects.category_file import get_category
from omad.objects.model import ObjectModel, odd_size

from . import partnet
from .alignment import align
from .articulation import RawArticulation, read_articulation
from .links import label_parts
from .shapes import PACKAGED, MissingMeshes
from .walls import through_walls

MIRRORED = "is the other way round than the spec says: taken as its mirror image"
"""The note on a model of the other hand."""
WRONG_WAY = "axis points the wrong way in the file, all of it is taken back to front; turn axis and limits round there"
"""Of what slides, and leaves its parent at the back."""
MODEL, RECORD = "a URDF or its folder", "import.json"
"""In a folder of imported models, beside their folders: where they come from."""
UPRIGHT = 0.9
"""Cosine from which an axis points up."""
MANY_TURNS = 4 * math.pi
"""Radians; no hinge's limit is so large ..."""
IN_DEGREES = "are radians in a URDF; of degrees so large, divide them by 57.3"
"""... and what is said of one that is."""
USUAL_UP = {"+z", "+y"}
"""Which axis of files is up."""
NORMALISED = (1.4, 3.6)
"""Least and largest diagonal of a model in a unit sphere, roughly."""
USUAL = 2.0
"""Category units that objects are across."""


@dataclass(frozen=True)
class Refusal:
    """A model that was not taken in."""

    name: str
    """Of the model."""
    reason: str
    """One line."""


@dataclass(frozen=True)
class ImportedModel:
    """A model that was taken in."""

    model: ObjectModel
    notes: list[str]
    """A line on everything that had to be put right about it."""
    up: str | None
    """Which of the file's axes points up in canonical space, as "+z"; None where none does, and where nothing was
    turned because the file is of canonical space itself."""


@dataclass(frozen=True)
class FolderImport:
    """What a folder of models gave."""

    models: list[ObjectModel]
    """Those that were taken in."""
    refused: list[Refusal]
    """Those that were not."""
    notes: list[Refusal] = field(default_factory=list)
    """What had to be put right about models that were taken in."""


def load_folder(folder: Path | str, category: Category, scale: float | None = None) -> FolderImport:
    """Import every object of ``folder``: one itself, or ``.urdf`` files, or one sub-folder an object, by name.
    ``scale`` as in ``import_model``. Objects that do not fit, or are of another unit, are listed with the reason.
    Raises InputError where ``folder`` does not exist or holds no object at all."""
    models, refused, notes = [], [], []
    up, z_up = dict[str, str](), set[str]()
    for source in object_paths(folder):
        try:
            found = _of_usual_size(source, category, scale, "refuse", None, folder)
        except InputError as error:
            refused.append(Refusal(object_name(source), str(error)))
        else:
            models.append(found.model)
            notes += [Refusal(found.model.name, note) for note in found.notes]
            up |= {} if found.up is None else {found.model.name: found.up}
            z_up |= {found.model.name} if of_partnet(source) else set()
    notes += lying(up, z_up, category.either_hand)
    return FolderImport(models, refused, notes)


def import_model(
    path: Path | str,
    category: Category,
    scale: float | None = None,
    missing_meshes: MissingMeshes = "refuse",
    mesh_folder: Path | None = None,
) -> ObjectModel:
    """Bring one foreign model, a ``.urdf`` or the folder that holds it, to the category's canonical space. ``scale`` is
    metres per unit of the file; left out, PartNet-Mobility folders have the category's and others 1. ``mesh_folder``:
    where meshes may lie besides the model's own folder. Raises InputError with the file and the reason where the model
    is broken, does not fit the category, or is of another unit."""
    path = as_path(path, MODEL)
    return _of_usual_size(path, category, scale, missing_meshes, mesh_folder, path).model


def _of_usual_size(
    path: Path,
    category: Category,
    scale: float | None,
    missing_meshes: MissingMeshes,
    mesh_folder: Path | None,
    folder: Path | str,
) -> ImportedModel:
    """A model of the ``folder``. Raises InputError where it is much too large or small, too."""
    found = import_with_notes(path, category, scale, missing_meshes, mesh_folder)
    if odd := size_doubt(found.model, category, scale_of(path, category, scale), folder):
        raise InputError(f"{path}: {odd}")
    return found


def import_with_notes(
    path: Path | str,
    category: Category,
    scale: float | None = None,
    missing_meshes: MissingMeshes = "refuse",
    mesh_folder: Path | None = None,
) -> ImportedModel:
    """``import_model``, and what it says of the model besides."""
    path = as_path(path, MODEL)
    with readable(path, f"a model of a {category.name}", "leave it out, or repair it"):
        return _imported(path, category, scale, missing_meshes, mesh_folder)


def _imported(
    path: Path, category: Category, scale: float | None, missing_meshes: MissingMeshes, mesh_folder: Path | None
) -> ImportedModel:
    file = urdf_of(path) if path.is_dir() else path
    normalised = partnet.is_partnet(file)
    if normalised:
        partnet.check_source_name(file.parent, category)
    assumed, scale = normalised and scale is None, scale_of(file, category, scale)
    raw = stated = read_articulation(file, scale, missing_meshes, mesh_folder)
    if normalised:
        raw = partnet.with_stated_axes(partnet.with_names(stated, file.parent), file.parent, scale)
    moved = [joint.name for joint, before in zip(raw.joints, stated.joints, strict=True) if joint is not before]
    notes = [f"axis of {', '.join(moved)} taken from {partnet.JOINTS}: the URDF has it elsewhere"] if moved else []
    notes += _odd_limits(raw)
    notes += [f"{one.name} moves by itself: mimic is not heeded" for one in raw.joints if one.follows]
    notes += [
        f"{one.name} has its lower limit above the upper: taken as exchanged" for one in raw.joints if one.inverted
    ]
    try:
        aligned = align(label_parts(raw, category), category)
    except InputError as error:
        cures = _cures(raw, category, file.parent if normalised else None)
        raise InputError("; ".join([f"{file}: not usable as {category.name}: {error}", *cures])) from error
    least, most = (scale * end for end in NORMALISED)
    if assumed and not least < aligned.model.diagonal < most:
        notes.append(f"is scaled by {scale:g}, as PartNet-Mobility's are: of lengths in metres, give --scale 1")
    of_other_hand = aligned.mirrored != (category.either_hand and _mirrored_before(path))
    notes += [MIRRORED] if of_other_hand else []
    if through := through_walls(aligned.model):
        notes.append(f"{', '.join(through)} open through a wall: where their {WRONG_WAY}")
    if stated.skipped:
        notes.append(f"is taken without {len(stated.skipped)} of its mesh files, which are missing")
    if stated.empty:
        notes.append(f"no triangles in {', '.join(stated.empty)}: taken without; export again what should have some")
    model = replace(aligned.model, name=object_name(path), of_other_hand=of_other_hand)
    up = None if aligned.as_it_stood else _up(aligned.R_canonical_source)
    return ImportedModel(model, notes, up)


def _odd_limits(raw: RawArticulation) -> list[str]:
    """What is said of limits that seem to be in degrees."""
    hinges = [joint for joint in raw.joints if joint.motion.turns and not joint.motion.slide]
    odd = [one.name for one in hinges if max(map(abs, one.limits or ()), default=0.0) > MANY_TURNS]
    return [f"limits of {', '.join(odd)} {IN_DEGREES}"] if odd else []


def scale_of(path: Path, category: Category, scale: float | None) -> float:
    """Metres per unit of a model's file, where ``scale`` is what was said of all."""
    if scale is not None:
        return scale
    return category.metres_per_unit if of_partnet(path) else 1.0


def of_partnet(path: Path) -> bool:
    """Whether a model's file or folder is of PartNet-Mobility: normalised, and z up."""
    return partnet.is_partnet(urdf_of(path) if path.is_dir() else path)


def size_doubt(model: ObjectModel, category: Category, scale: float, folder: Path | str) -> str | None:
    """What to say of a model of ``folder`` that is much too large or small, taken at ``scale``, with the import that
    makes it usual."""
    odd = odd_size(model.diagonal, category)
    if odd is None:
        return None
    factor = 10.0 ** round(math.log10(USUAL * category.metres_per_unit / model.diagonal))
    spec = category.name if category.name in builtin_names() else "SPEC.toml"
    command = shlex.join(["omad", "import", str(folder), "--category", spec, "--output", "imported"])
    cure = f"{command} --scale {factor * scale:g} (metres per unit of its file)"
    return f"{odd}; {cure} makes it {factor * model.diagonal:.3g} m"


def lying(up: dict[str, str], z_up: Collection[str], either_hand: bool) -> list[Refusal]:
    """Models, by the axes of their files that were turned ``up``, that have another one up than most. Where most do not
    agree, as one alone, or all lie as files seldom do: those that have one up that files seldom have, of those named in
    ``z_up`` any but z. Where the spec knows of one hand alone, they may be of the other one."""
    usual, count = Counter(up.values()).most_common(1)[0] if up else ("", 0)
    agreed = count > max(1, len(up) / 2)
    cure = "if it lies or stands on its head, leave it out, or it belongs to another category"
    if not either_hand:
        cure += "; if it is the mirror image of the others, say either_hand = true in the spec"
    found = []
    for name, axis in up.items():
        if agreed and usual in USUAL_UP:
            expected, others = {usual}, f"the others with {usual}"
        elif name in z_up:
            expected, others = {"+z"}, "PartNet-Mobility's files have z up"
        else:
            expected, others = USUAL_UP, "most files have z or y up"
        if axis not in expected:
            found.append(Refusal(name, f"stands with its file's {axis} up, {others}: look at it; {cure}"))
    return found


@lru_cache(maxsize=1)
def _read_record(record: Path, _changed: int) -> Any:
    """What an import wrote, once for all of its models; None where it cannot be read."""
    with suppress(InputError):
        return read_json(record, "")
    return None


def _mirrored_before(path: Path) -> bool:
    """Whether an earlier import wrote this model as the mirror image of what it had come from."""
    record = next((file for folder in path.absolute().parents[:2] if is_file(file := folder / RECORD)), None)
    found = None if record is None else _read_record(record, record.stat().st_mtime_ns)
    for key in ("notes", object_name(path)):
        found = found.get(key) if isinstance(found, dict) else None
    return isinstance(found, list) and MIRRORED in found


def _cures(raw: RawArticulation, category: Category, partnet_folder: Path | None) -> list[str]:
    """For a model that does not fit the ``category``, what may help."""
    cures = [f"no triangles in {', '.join(raw.empty)}: export again"] if raw.empty else []
    if category.name not in builtin_names():
        with suppress(InputError, ValueError):  # of a category that cannot be of either hand
            either = replace(category, either_hand=True)
            align(label_parts(raw, either), either)
            cures.append("its mirror image fits: if such objects are of either hand, say so in the spec (either_hand)")
    others = _fitting(raw, category, partnet_folder)
    return [*cures, f"it fits --category {' or '.join(others)}"] if others else cures


def _fitting(raw: RawArticulation, category: Category, partnet_folder: Path | None) -> list[str]:
    """Shipped categories with another number of such parts, as their aliases tell, that a model fits which does not fit
    the ``category``; with more of them where it is jointed as that one is."""
    found, aliases, least = [], {alias for part in category.parts[1:] for alias in part.aliases}, 0
    with suppress(InputError):
        next(label_parts(raw, category))
        least = len(category.parts)
    for other in map(get_category, builtin_names()):
        alike = all(aliases.intersection(part.aliases) for part in other.parts[1:])
        if alike and len(other.parts) != len(category.parts) and len(other.parts) > least:
            with suppress(InputError):
                if partnet_folder is not None:
                    partnet.check_source_name(partnet_folder, other)
                align(label_parts(raw, other), other)
                found.append(other)
    # those first of which data sets speak as they do of this one, and that take most of the model's parts
    akin = {*category.source_names}
    found.sort(key=lambda other: (akin.isdisjoint(other.source_names), -len(other.parts)))
    return [other.name for other in found]


def _up(R_canonical_source: np.ndarray) -> str | None:
    up = R_canonical_source[1]  # of canonical space, as the file's frame has it
    axis = int(np.abs(up).argmax())
    return ("+" if up[axis] > 0 else "-") + "xyz"[axis] if abs(up[axis]) > UPRIGHT else None


def object_paths(folder: Path | str) -> list[Path]:
    """The ``.urdf`` files or sub-folders of ``folder``, one an object, by name; or ``folder`` itself, if it is one, a
    ROS package, say. Raises InputError where ``folder`` does not exist, or holds no object or two of one name."""
    folder = as_path(folder, "a folder of URDF models")
    if not (os.path.isdir(folder) or os.path.isfile(folder)):
        raise InputError(f"{folder}: no such folder; give a folder of URDF models")
    if folder.is_file() or (folder / partnet.URDF).is_file():
        return [folder]
    if not _urdf_files(folder) and len(_urdf_files(folder / PACKAGED)) == 1 and is_file(folder / "package.xml"):
        return [folder]
    folders = sorted(sub for sub in folder.iterdir() if sub.is_dir() and not sub.name.startswith("."))
    alone = _urdf_files(folder)  # beside such, folders of their meshes may lie
    found = sorted([*alone, *(sub for sub in folders if not alone or _urdf_files(sub) or _urdf_files(sub / PACKAGED))])
    if not found:
        raise InputError(f"{folder}: no .urdf in it or in its sub-folders; give a folder of URDF models")
    called = dict[str, Path]()
    for path in found:
        if (other := called.setdefault(object_name(path), path)) != path:
            raise InputError(f"{path}: is called as {other} is; rename one of them")
    return found


def urdf_of(folder: Path) -> Path:
    """The one URDF of an object's folder, which may be a ROS package. Raises InputError where there is no such one."""
    if (folder / partnet.URDF).is_file():
        return folder / partnet.URDF
    files = next(filter(None, map(_urdf_files, (folder, folder / PACKAGED))), [])
    if len(files) != 1:
        found, cure = (f"{len(files)} .urdf files", "keep one of them there") if files else ("no .urdf file", "add one")
        raise InputError(f"{folder}: {found}, expected one that names its meshes; {cure}, or give the file itself")
    return files[0]


def object_name(path: Path) -> str:
    """An object is called like its folder, a lone file like itself."""
    path = Path(os.path.abspath(path))  # links to folders of one name are objects of several
    if path.name == partnet.URDF:
        path = path.parent
    return path.stem if is_urdf(path) else path.name


def is_urdf(path: Path) -> bool:
    """By its extension, in capitals or not."""
    return path.suffix.lower() == ".urdf"


def _urdf_files(folder: Path) -> list[Path]:
    return sorted(filter(is_urdf, folder.iterdir())) if folder.is_dir() else []
