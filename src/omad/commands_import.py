"""The command that brings other people's models in."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import tyro

from .errors import InputError
from .importing import PICTURE, import_folder
from .options import CategoryName, Json, Result, check_positive
from .spec_file import get_category


@dataclass(frozen=True)
class Import:
    """Turn a folder of URDF or PartNet-Mobility models into canonical ones, which --source takes; resumes where it
    stopped. Prints what was refused and why, and draws the others for a look at how they stand."""

    source: tyro.conf.Positional[Path]
    """Folder of models: .urdf files, or a sub-folder for each."""
    category: CategoryName
    output: Path
    """Folder for a sub-folder an object, the summary and the picture."""
    scale: float | None = None
    """Metres per unit of the files; default: the category's for PartNet-Mobility, 1 for others."""
    missing_meshes: Literal["refuse", "skip"] = "refuse"
    """Of models whose mesh files are not all there: refuse the model, or use what is there."""
    json: Json = False

    def run(self) -> Result:
        check_positive(scale=self.scale)
        category = get_category(self.category)
        summary = import_folder(self.source, category, self.output, self.scale, self.missing_meshes)
        if not summary.used and len(summary.refused) == 1:
            raise InputError(f"{self.source}: no usable model in it: {summary.refused[0].reason}")
        answer = {
            "folder": str(self.output),
            "category": category.name,
            "models": len(summary.used) + len(summary.refused),
            "used": summary.used,
            "refused": [asdict(refusal) for refusal in summary.refused],
            "reasons": summary.reasons,
            "notes": [asdict(note) for note in summary.notes],
            "picture": str(self.output / PICTURE) if summary.used else None,
        }
        return (0 if summary.used else 2), answer
