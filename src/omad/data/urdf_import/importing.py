"""A folder of other people's models becomes a folder of canonical ones, which every command takes as its source.

<output>/<object>/<object>.urdf    root = canonical space, zero = rest state; meshes/ beside it
<output>/import.json               what was imported from where, and what was refused and why
"""

import hashlib
import json
import os
import re
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from tqdm import tqdm

from omad.common.errors import InputError
from omad.common.files import make_folder, write_json
from omad.common.incoming import read_record, read_text
from omad.common.processes.locks import only_one
from omad.common.stderr import is_watched
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.objects.urdf import mesh_files, write_urdf

from .articulation import read_urdf
from .folder import (
    MIRRORED,
    RECORD,
    ImportedModel,
    Refusal,
    import_with_notes,
    lying,
    object_name,
    object_paths,
    of_partnet,
    scale_of,
    size_doubt,
    urdf_of,
)
from .shapes import MeshFiles, MissingMeshes

_NO_NAME = "\0\\:" if os.name == "nt" else "\0"


@dataclass(frozen=True)
class ImportSummary:
    """What became of a folder of models."""

    models: list[ObjectModel]
    """Those that are used, as they stand in their new files."""
    refused: list[Refusal]
    notes: list[Refusal]
    """What had to be put right about models that are used."""
    doubts: list[Refusal]
    """What may be wrong with models that are used."""

    @property
    def used(self) -> list[str]:
        """Names."""
        return [model.name for model in self.models]

    @property
    def reasons(self) -> dict[str, int]:
        """How many models were refused for each reason, commonest first; without what is special to a model."""
        return dict(Counter(_in_general(refusal.reason) for refusal in self.refused).most_common())

    def to_dict(self) -> dict[str, Any]:
        """Names instead of models, and all else, as plain values."""
        listed = {"refused": self.refused, "notes": self.notes, "warnings": self.doubts}
        plain = {name: [asdict(each) for each in entries] for name, entries in listed.items()}
        return {"used": self.used, "reasons": self.reasons, **plain}


def import_folder(
    source: Path,
    category: Category,
    output: Path,
    scale: float | None = None,
    missing_meshes: MissingMeshes = "refuse",
    mesh_folder: Path | None = None,
) -> ImportSummary:
    """Import every model of ``source`` into ``output``; what is there already, from unchanged files and the same spec,
    stays. Raises InputError where ``source`` holds no models, and where ``output`` was made with other options."""
    paths = [path for path in object_paths(source) if path.resolve() != output.resolve()]  # it may lie among them
    if output.resolve() in (source.resolve(), *source.resolve().parents):
        raise InputError(f"{output}: would be written into the models it comes from; choose another folder")
    options = {"source": str(source.resolve()), "category": asdict(category), "scale": scale}
    options = json.loads(json.dumps({**options, "missing_meshes": missing_meshes}))

    def importing(path: Path) -> ImportedModel:
        return import_with_notes(path, category, scale, missing_meshes, mesh_folder)

    make_folder(output)
    with only_one(output, "an import"):
        return _import_all(paths, category, output, _Record.open(output, options), importing, mesh_folder)


def _import_all(
    paths: list[Path],
    category: Category,
    output: Path,
    record: "_Record",
    importing: Callable[[Path], ImportedModel],
    mesh_folder: Path | None,
) -> ImportSummary:
    for name in set(record.stamps) - {object_name(path) for path in paths}:
        record.drop(name)
    refused, notes, models, doubts = [], [], [], []
    for path in tqdm(paths, unit="model", file=sys.stderr, disable=not is_watched()):
        name = object_name(path)
        file = output / name / f"{name}.urdf"
        try:
            _check_plain(name, f"{path}: an object's name")
            stamp = _stamp(path, mesh_folder, output)
            if record.stamps.get(name) != stamp or not file.is_file():
                found = importing(path)
                record.drop(name)
                if file.parent.is_symlink():
                    raise InputError(f"{file.parent}: leads out of the folder; remove it")
                record.write({})  # before the first file, so that whatever kills it leaves a folder that goes on
                write_urdf(found.model, file)
                record.add(name, stamp, found, [file, *mesh_files(found.model, file)])
            said = record.notes.get(name, [])
            model = replace(read_urdf(file, category), of_other_hand=MIRRORED in said)
            models.append(model)
            taken_at = scale_of(path, category, record.options["scale"])
            odd = size_doubt(model, category, taken_at, record.options["source"])
            doubts += [Refusal(name, odd)] if odd else []
            notes += [Refusal(name, note) for note in said]
        except InputError as error:
            refused.append(Refusal(name, str(error)))
            record.drop(name)
    z_up = {object_name(path) for path in paths if object_name(path) in record.up and of_partnet(path)}
    summary = ImportSummary(models, refused, [*notes, *lying(record.up, z_up, category.either_hand)], doubts)
    if models or (output / RECORD).is_file():
        record.write(summary.to_dict())
    return summary


@dataclass
class _Record:
    """``import.json``, kept after every model, so that an interrupted import goes on. It may have come with a folder
    from anywhere: what it says is checked, and no file goes but one that still is as it was written."""

    options: dict[str, Any]
    stamps: dict[str, str]
    """By name, what tells that a model's files changed."""
    notes: dict[str, list[str]]
    written: dict[str, dict[str, str]] = field(default_factory=dict)
    """By name, the digests of the files that were written for a model, by their paths in its folder."""
    up: dict[str, str] = field(default_factory=dict)
    """By name, which of the axes of a model's file points up, where one does."""
    folder: Path = Path()

    @classmethod
    def open(cls, output: Path, options: dict[str, Any]) -> Self:
        """Raises InputError where ``output`` holds something else, or was made with other options."""
        file = output / RECORD
        if not file.is_file():
            if any(output.iterdir()):
                raise InputError(f"{output}: is not empty and not of omad import; choose another folder")
            return cls(options, {}, {}, folder=output)
        found = read_record(_Kept, file, "remove the folder, or choose another one")
        for name in {*found.stamps, *found.written}:
            _check_plain(name, f"{file}: a model's name")
            for path in found.written.get(name, {}):
                _check_inside(path, f"{file}: {name!r}")
        said = found.options.get("category")
        mended = (
            isinstance(said, dict) and said != options["category"] and said.get("name") == options["category"]["name"]
        )
        for key, value in options.items():
            if found.options.get(key) != value and not (mended and key == "category"):
                raise InputError(f"{output}: was made with another {key}; choose another folder, or remove this one")
        notes = {name: list(said) for name, said in found.notes.items()}
        stamps = dict.fromkeys(found.stamps, "") if mended else found.stamps  # of a spec that was mended, all anew
        return cls(options, stamps, notes, found.written, found.up, output)

    def add(self, name: str, stamp: str, found: ImportedModel, files: list[Path]) -> None:
        """A model was written into these ``files``."""
        self.stamps[name], self.notes[name] = stamp, found.notes
        self.up |= {} if found.up is None else {name: found.up}
        self.written[name] = {file.relative_to(self.folder / name).as_posix(): _digest(file) for file in files}
        self.write({})

    def drop(self, name: str) -> None:
        """Forget a model, and remove what an earlier run wrote of it, as far as nobody has changed it since."""
        self.stamps.pop(name, None)
        self.notes.pop(name, None)
        self.up.pop(name, None)
        made, folders = self.folder / name, set[Path]()
        for path, digest in self.written.pop(name, {}).items():
            file = made / path
            outside = any(each.is_symlink() for each in (file, *file.parents) if each.is_relative_to(made))
            if not outside and file.is_file() and _digest(file) == digest:
                file.unlink()
                folders |= {each for each in file.parents if each.is_relative_to(made)}
        for folder in sorted(folders, reverse=True):  # the inner ones first
            with suppress(OSError):  # of another's files in it
                folder.rmdir()

    def write(self, summary: dict[str, Any]) -> None:
        values = {
            "options": self.options,
            "stamps": self.stamps,
            "notes": self.notes,
            "written": self.written,
            "up": self.up,
        }
        write_json(self.folder / RECORD, {**values, "summary": summary}, indent=1)


@dataclass(frozen=True)
class _Kept:
    """What ``import.json`` holds."""

    options: dict[str, Any]
    stamps: dict[str, str]
    notes: dict[str, tuple[str, ...]]
    written: dict[str, dict[str, str]]
    up: dict[str, str] = field(default_factory=dict)


def _check_inside(path: str, what: str) -> None:
    """Raises InputError for a path that leads out of the folder it is said to be in."""
    words = path.split("/")
    if not all(words) or {".", ".."} & {*words} or {*path} & {*_NO_NAME}:
        raise InputError(f"{what}: holds the path {path!r}, which is not inside; remove the folder, or choose another")


def _check_plain(name: str, what: str) -> None:
    """Raises InputError for a name that cannot be a folder's."""
    _check_inside(name, what)
    if "/" in name:
        raise InputError(f"{what}: is {name!r}; rename it")


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _stamp(path: Path, mesh_folder: Path | None, output: Path) -> str:
    """Changes when a file of the object does, or a mesh that it takes from elsewhere; what is written to ``output``,
    which may lie beside it, is none of it."""
    folder, written = path if path.is_dir() else path.parent, output.resolve()
    files = {file for file in folder.rglob("*") if file.is_file() and not file.resolve().is_relative_to(written)}
    urdf = urdf_of(path) if path.is_dir() else path
    named = re.findall(r"filename *= *[\"'](.*?)[\"']", read_text(urdf, errors="replace"))
    found = filter(None, map(MeshFiles(urdf, folder=mesh_folder).find, named))
    files |= {file for file in found if not file.is_relative_to(folder.resolve())}
    stats = ((file, file.stat()) for file in sorted(files))
    text = "\n".join(f"{_place(file, folder)} {stat.st_size} {stat.st_mtime_ns}" for file, stat in stats)
    return hashlib.sha256(text.encode()).hexdigest()


def _place(file: Path, folder: Path) -> str:
    """As seen from the folder, so that both may be moved; on Windows they may lie on two drives."""
    try:
        return os.path.relpath(file, folder)
    except ValueError:
        return str(file)


def _in_general(reason: str) -> str:
    """A reason without the file before it, the cure behind it, and the names in it that differ between models."""
    said = re.sub(r"^not usable as [^:]*: ", "", reason.split(": ", 1)[-1])
    return re.sub(r"'[^']*'", "...", said.split(";")[0])
