"""A folder of other people's models becomes a folder of canonical ones, which every command takes as its source.

<output>/<object>/<object>.urdf    root = canonical space, zero = rest state; meshes/ beside it
<output>/import.json               what was imported from where, and what was refused and why
<output>/models.png                the imported models, to see that they stand alike
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from .categories import Category
from .contact_sheet import contact_sheet
from .errors import InputError
from .files import write_atomic
from .report import save
from .sources.folder import Refusal, import_with_notes, object_name, object_paths
from .urdf import MissingMeshes, read_urdf, write_urdf

RECORD = "import.json"
PICTURE = "models.png"


@dataclass(frozen=True)
class ImportSummary:
    """What became of a folder of models."""

    used: list[str]
    """Names."""
    refused: list[Refusal]
    notes: list[Refusal]
    """What had to be put right about models that are used."""

    @property
    def reasons(self) -> dict[str, int]:
        """How many models were refused for each reason, commonest first; without what is special to a model."""
        return dict(Counter(_in_general(refusal.reason) for refusal in self.refused).most_common())


def import_folder(
    source: Path, category: Category, output: Path, scale: float | None = None, missing_meshes: MissingMeshes = "refuse"
) -> ImportSummary:
    """Import every model of ``source`` into ``output``; what is there already, from unchanged files, stays.

    Raises InputError where ``source`` holds no models, and where ``output`` was made with other options.
    """
    paths = object_paths(source)
    if output.resolve() in (source.resolve(), *source.resolve().parents):
        raise InputError(f"{output}: would be written into the models it comes from; choose another folder")
    options = {
        "source": str(source.resolve()), "category": asdict(category), "scale": scale, "missing_meshes": missing_meshes
    }  # fmt: skip
    record = _Record.open(output, json.loads(json.dumps(options)))
    for name in set(record.stamps) - {object_name(path) for path in paths}:
        record.drop(name)
    refused, notes, models = [], [], []
    for path in tqdm(paths, unit="model", file=sys.stderr, disable=not sys.stderr.isatty()):
        name, file = object_name(path), output / object_name(path) / f"{object_name(path)}.urdf"
        stamp = _stamp(path)
        try:
            if record.stamps.get(name) != stamp or not file.is_file():
                imported = import_with_notes(path, category, scale, missing_meshes)
                write_urdf(imported.model, file)
                record.add(name, stamp, imported.notes)
            models.append(read_urdf(file, category))
            notes += [Refusal(name, note) for note in record.notes[name]]
        except InputError as error:
            refused.append(Refusal(name, str(error)))
            record.drop(name)
    if models:
        save(contact_sheet(models), output / PICTURE)
    summary = ImportSummary([model.name for model in models], refused, notes)
    if models or record.file.is_file():
        record.finish(summary)
    return summary


@dataclass
class _Record:
    """``import.json``, kept after every model, so that an interrupted import goes on."""

    file: Path
    options: dict[str, Any]
    stamps: dict[str, str]
    notes: dict[str, list[str]]

    @classmethod
    def open(cls, output: Path, options: dict[str, Any]) -> _Record:
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

    def add(self, name: str, stamp: str, notes: Sequence[str]) -> None:
        self.stamps[name], self.notes[name] = stamp, list(notes)
        self._write({})

    def drop(self, name: str) -> None:
        """Forget a model that is no longer among the source's usable ones, and remove what an earlier run wrote."""
        self.stamps.pop(name, None)
        self.notes.pop(name, None)
        shutil.rmtree(self.file.parent / name, ignore_errors=True)

    def finish(self, summary: ImportSummary) -> None:
        self._write({**asdict(summary), "reasons": summary.reasons})

    def _write(self, more: dict[str, Any]) -> None:
        values = {"options": self.options, "stamps": self.stamps, "notes": self.notes}
        text = json.dumps(values | {"summary": more}, indent=1) + "\n"
        write_atomic(self.file, lambda path: path.write_text(text))


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
