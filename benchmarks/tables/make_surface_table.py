"""Hold the shipped weights' surfaces against true ones and write the table of docs/surfaces.md.

    OMP_NUM_THREADS=1 python benchmarks/tables/make_surface_table.py [--models FOLDER] [--categories laptop drawer]

``--models``: a folder with one sub-folder of URDF or PartNet-Mobility models a category; without it the columns of
other people's models are empty. Rows of categories that are not asked for stay. Answers are kept in ``--cache``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tyro
from make_tables import SURFACES, in_order, kept, replaced

from omad.cli.evaluation.shape import EvalShape
from omad.cli.options import Views
from omad.common.files import write_atomic

COLUMNS = "distance | F"


@dataclass(frozen=True)
class Config:
    """What to measure."""

    models: Path | None = None
    categories: tuple[str, ...] = ()
    """Default: all that have weights, the paper's first."""
    cache: Path = Path("runs/surfaces")
    views: int = 100
    """Of as many procedural objects."""
    model_views: int = 24
    """Of other people's models together."""


def measured(config: Config, category: str, source: str, views: int) -> dict[str, Any]:
    """The answer of ``omad eval shape``, from the cache where it is there."""
    kind = "procedural" if source == "procedural" else "models"
    file = config.cache / f"{category}-{kind}-{views}.json"
    data = Views(source=source, objects=config.views, views=views)
    return kept(file, lambda: EvalShape(category=category, data=data).run().record)


def cells(answer: dict[str, Any]) -> str:
    """Mean distance and F-score of the whole object; in brackets the hulls'."""
    surface, hull = answer["surface"]["whole"], answer["hull"]["whole"]
    told = [
        f"{surface[name]['mean']:.{digits}f} ({hull[name]['mean']:.{digits}f})"
        for name, digits in (("distance", 4), ("f_score", 3))
    ]
    return " | ".join(told)


def table(config: Config) -> list[str]:
    """A line a category."""
    lines = [f"| | procedural: {COLUMNS} | other people's: {COLUMNS} |", "|---" * 5 + "|"]
    for name in config.categories:
        own, foreign = cells(measured(config, name, "procedural", config.views)), " | "
        if config.models is not None and (config.models / name).is_dir():
            foreign = cells(measured(config, name, str(config.models / name), config.model_views))
        lines.append(f"| {name} | {own} | {foreign} |")
    return lines


def main(config: Config) -> None:
    some = config.categories
    lines = table(replace(config, categories=some or in_order()))
    text = replaced(SURFACES.read_text(), "surfaces", lines, some)
    write_atomic(SURFACES, lambda path: path.write_text(text))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
