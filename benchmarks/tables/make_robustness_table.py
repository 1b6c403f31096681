"""Measure the shipped weights on spoilt views and write the table of docs/robustness.md.

    OMP_NUM_THREADS=1 python benchmarks/tables/make_robustness_table.py [--categories laptop laptop/cluttered]
        [--views 200]
    OMP_NUM_THREADS=1 python benchmarks/tables/make_robustness_table.py --models FOLDER [--views 60]
    OMP_NUM_THREADS=1 python benchmarks/tables/make_robustness_table.py --to-surface [--models FOLDER]

The table stands between ``<!-- robustness -->`` and ``<!-- end -->``, that of other people's models, a sub-folder of
``--models`` for each category, between ``<!-- robustness-models -->`` and ``<!-- end -->``. After either name follows
``-seen`` where the table is of the joints whose part shows, and ``-surface`` with ``--to-surface``. Answers are kept in
``--cache`` and made anew only where they are missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from make_tables import FIVE, kept, put

from omad.cli.evaluation.robustness import EvalRobustness, SpoiltViews
from omad.evaluation.robustness.rows import CLEAN

AMISS = (
    "smooth-3", "wide-3-table", "wide-3-shelf", "wide-3-clutter", "wide-6-table", "hidden-25", "hidden-25-rim",
    "cut-off-25", "steep", "below", "around", "together",
)  # fmt: skip
"""Rows where much is amiss."""
HIDING = ("hidden-25", "hidden-25-rim", "cut-off-25", "steep", "below", "around", "together")
"""Rows where parts may hardly show."""
PAGE = Path(__file__).parents[2] / "docs" / "robustness.md"


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = FIVE
    """Of others, or of some of these, the table is printed, and the page stays."""
    views: int = 60
    """Of each row; of procedural objects each shows another one."""
    models: Path | None = None
    """Default: procedural objects."""
    to_surface: bool = False
    """Beside each answer, how far it is off when it goes on towards its surface; of the rows where much is amiss."""
    cache: Path = Path("runs/robustness")


def measured(config: Config, category: str, to_surface: bool = False) -> dict[str, Any]:
    """The answer of ``omad eval robustness``, from the cache where it is there."""
    name, _, other = category.partition("/")
    kind, source = ("", "procedural") if config.models is None else ("-models", str(config.models / name))
    kind, rows = (f"{kind}-surface", AMISS) if to_surface else (kind, ())
    file = config.cache / f"{category.replace('/', '-')}{kind}-{config.views}.json"
    weights = Path(category) if other else None
    asked = EvalRobustness(
        category=name,
        weights=weights,
        data=SpoiltViews(source=source, views=config.views),
        rows=rows,
        to_surface=to_surface,
    )
    return kept(file, lambda: asked.run().record)


def surface_table(answers: dict[str, tuple[dict[str, Any], dict[str, Any]]]) -> list[str]:
    """A line a row, a column a category: mean error of the answer, of that which goes on towards its surface, and what
    they are of such answers to clean views."""
    lines = [f"| row | {' | '.join(answers)} |", "|---" * (len(answers) + 1) + "|"]
    for name in (CLEAN, *AMISS):
        cells = []
        for pair in answers.values():
            either = [row for answer in pair for row in answer["rows"] if row["row"] == name]
            errors, ratios = ", ".join(map(mean, either)), ", ".join(f"{row['ratio']:.2f}" for row in either)
            cells.append(errors if name == CLEAN else f"{errors}; {ratios}")
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return lines


def table(answers: dict[str, dict[str, Any]]) -> list[str]:
    """A line a row, a column a category."""
    by_row: dict[str, dict[str, dict[str, Any]]] = {}
    for category, answer in answers.items():
        for row in answer["rows"]:
            by_row.setdefault(row["row"], {})[category] = row
    lines = [f"| row | {' | '.join(answers)} |", "|---" * (len(answers) + 1) + "|"]
    for row, rows in by_row.items():
        cells = (cell(rows[name], answer["views"]) if name in rows else "-" for name, answer in answers.items())
        lines.append(f"| `{row}` | {' | '.join(cells)} |")
    told = (judged(answer) for answer in answers.values())
    return [*lines, f"| all of them, and other categories' objects | {' | '.join(told)} |"]


def seen_table(answers: dict[str, dict[str, Any]]) -> list[str]:
    """A line a row, a column a category: mean error of the joints whose part shows, what it is of that of the same
    joints when clean, and the share of the other joints."""
    lines = [f"| row | {' | '.join(answers)} |", "|---" * (len(answers) + 1) + "|"]
    for name in HIDING:
        rows = (next(row for row in answer["rows"] if row["row"] == name)["seen"] for answer in answers.values())
        cells = (f"{mean(seen)}, {seen['ratio']:.2f}; {100 * (1 - seen['share']):.0f} %" for seen in rows)
        lines.append(f"| `{name}` | {' | '.join(cells)} |")
    return lines


def judged(answer: dict[str, Any]) -> str:
    """Calibration error and area under the ROC of the probability."""
    told = answer["probability"]
    return f"ECE {told['calibration_error']:.3f}, AUC {told['area_under_roc']:.3f}" if told else "-"


def cell(row: dict[str, Any], views: int) -> str:
    """Mean error, and that of the answers that are not flagged; shares covered by the 50 % and the 90 % interval,
    flagged and silently wrong; the number of views where it is not ``views``."""
    errors = ", ".join(mean(of) for of in (row, row["trusted"]))
    shares = (f"{100 * row[key]:.0f}" for key in ("covered_50", "covered_90", "flagged", "silently_wrong"))
    fewer = f" ({row['views']})" if row["views"] < views else ""
    return f"{errors}; {' / '.join(shares)}{fewer}"


def mean(of: dict[str, Any]) -> str:
    """Degrees, or centimetres."""
    angle, length = of["joint_state_error_deg"], of["joint_state_error"]
    return f"{angle['mean']:.1f}°" if angle else f"{100 * length['mean']:.1f} cm" if length else "-"


def main(config: Config) -> None:
    answers = {category: measured(config, category) for category in config.categories}
    name = "robustness" if config.models is None else "robustness-models"
    if config.to_surface:
        both = {category: (answer, measured(config, category, True)) for category, answer in answers.items()}
        name, lines = f"{name}-surface", surface_table(both)
    else:
        lines = table(answers)
        put(PAGE, f"{name}-seen", seen_table(answers), config.categories == FIVE)
    put(PAGE, name, lines, config.categories == FIVE)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
