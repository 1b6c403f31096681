"""A folder of other people's models becomes a folder of canonical ones, which every command takes as its source.

<output>/<object>/<object>.urdf    root = canonical space, zero = rest state; meshes/ beside it
<output>/import.json               what was imported from where, and what was refused and why
"""

import hashlib
import json
import re
import shutil
import sys
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from tqdm import tqdm

from omad.common.errors import InputError
from omad.common.files import write_json
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf

from .articulation import MissingMeshes, read_urdf
from .folder import Refusal, import_with_notes, object_name, object_paths

RECORD = "import.json"


@dataclass(frozen=True)
class ImportSummary:
    """What became of a folder of models."""

    models: list[ObjectModel]
    """Those that are used, as they stand in their new files."""
    refused: list[Refusal]
    notes: list[Refusal]
    """What had to be put right about models that are used."""

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
        refused, notes = ([asdict(each) for each in listed] for listed in (self.refused, self.notes))
        return {"used": self.used, "refused": refused, "reasons": self.reasons, "notes": notes}


def import_folder(
    source: Path, category: Category, output: Path, scale: float | None = None, missing_meshes: MissingMeshes = "refuse"
) -> ImportSummary:
    """Import every model of ``source`` into ``output``; what is there already, from unchanged files, stays. Raises
    InputError where ``source`` holds no models, and where ``output`` was made with other options."""
    paths = object_paths(source)
    if output.resolve() in (source.resolve(), *source.resolve().parents):
        raise InputError(f"{output}: would be written into the models it comes from; choose another folder")
    options = {"source": str(source.resolve()), "category": asdict(category), "scale": scale}
    record = _Record.open(output, json.loads(json.dumps({**options, "missing_meshes": missing_meshes})))
    for name in set(record.stamps) - {object_name(path) for path in paths}:
        record.drop(name)
    refused, notes, models = [], [], []
    for path in tqdm(paths, unit="model", file=sys.stderr, disable=not sys.stderr.isatty()):
        name, file = object_name(path), output / object_name(path) / f"{object_name(path)}.urdf"
        stamp = _stamp(path)
        try:
            if record.stamps.get(name) != stamp or not file.is_file():
                model, said = import_with_notes(path, category, scale, missing_meshes)
                write_urdf(model, file)
                record.add(name, stamp, said)
            models.append(read_urdf(file, category))
            notes += [Refusal(name, note) for note in record.notes[name]]
        except InputError as error:
            refused.append(Refusal(name, str(error)))
            record.drop(name)
    summary = ImportSummary(models, refused, notes)
    if models or record.file.is_file():
        record.write(summary.to_dict())
    return summary


@dataclass
class _Record:
    """``import.json``, kept after every model, so that an interrupted import goes on."""

    file: Path
    options: dict[str, Any]
    stamps: dict[str, str]
    notes: dict[str, list[str]]

    @classmethod
    def open(cls, output: Path, options: dict[str, Any]) -> Self:
        """Raises InputError where ``output`` holds something else, or was made with other options."""
        file = output / RECORD
        if not file.is_file():
            if output.exists() and any(output.iterdir() if output.is_dir() else [output]):
                raise InputError(f"{output}: is not empty and not of omad import; choose another folder")
            return cls(file, options, {}, {})
        try:
            found = json.loads(file.read_text())
            record = cls(file, found["options"], found["stamps"], found["notes"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{file}: is broken; remove the folder, or choose another one") from error
        for key, value in options.items():
            if record.options.get(key) != value:
                raise InputError(f"{output}: was made with another {key}; choose another folder, or remove this one")
        return record

    def add(self, name: str, stamp: str, notes: list[str]) -> None:
        self.stamps[name], self.notes[name] = stamp, notes
        self.write({})

    def drop(self, name: str) -> None:
        """Forget a model that is no longer among the source's usable ones, and remove what an earlier run wrote."""
        self.stamps.pop(name, None)
        self.notes.pop(name, None)
        shutil.rmtree(self.file.parent / name, ignore_errors=True)

    def write(self, summary: dict[str, Any]) -> None:
        values = {"options": self.options, "stamps": self.stamps, "notes": self.notes, "summary": summary}
        write_json(self.file, values, indent=1)


def _stamp(path: Path) -> str:
    """Changes when a file of the object does."""
    folder = path if path.is_dir() else path.parent
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    text = "\n".join(f"{file.relative_to(folder)} {(s := file.stat()).st_size} {s.st_mtime_ns}" for file in files)
    return hashlib.sha256(text.encode()).hexdigest()


def _in_general(reason: str) -> str:
    """A reason without the file before it, the cure behind it, and the names in it that differ between models."""
    said = re.sub(r"^not usable as [^:]*: ", "", reason.split(": ", 1)[-1])
    return re.sub(r"'[^']*'", "...", said.split(";")[0])
