"""Make the tables of docs/experiments.md from the shipped weights.

    OMP_NUM_THREADS=1 python benchmarks/tables/make_experiments.py [--ablation omad-ablation] [--ablation-of laptop]

Tables stand between ``<!-- name -->`` and ``<!-- end -->``. Predictions are kept in ``--cache``. Trainings of the
ablation are taken from where ``omad eval ablation`` left them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from make_tables import FIVE, each, put

from omad.cli.paper import EvalAblation, EvalTable1, EvalTable2
from omad.common.errors import InputError

PAGE = Path(__file__).parents[2] / "docs" / "experiments.md"
NAMES = {"ancsh": "A-NCSH", "omad_initial": "OMAD initial", "omad_refined": "**OMAD refined**"}
HEAD = ["joint state (° or u)", "axis angle (°)", "axis distance (u)", "rotation (°)", "translation (u)", "3D IoU"]


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = FIVE
    """Of others, or of some of these, tables are printed, and the page stays."""
    ablation: Path = Path("omad-ablation")
    ablation_of: str = "laptop"
    samples: int = 16_000
    """Views that the ablation's networks were trained on."""
    cache: Path = Path("runs/predictions")


def numbers(values: list[float | None], digits: int) -> str:
    """Of all joints or parts, once where all look the same."""
    told = [f"{value:.{digits}f}" for value in values if value is not None]
    return each(told) if told else "-"


def cells(line: dict[str, Any]) -> list[str]:
    slides = None in line["axis_distance"]
    return [
        numbers(line["joint_state"], 3 if slides else 1),
        numbers(line["axis_error_deg"], 1),
        numbers(line["axis_distance"], 3),
        numbers(line["rotation_error_deg"], 1),
        numbers(line["translation_error"], 3),
        numbers(line["iou"], 2),
    ]


def paper_cells(line: dict[str, Any]) -> list[str]:
    paper = line["paper"]
    slides = None in line["axis_distance"]
    return [
        numbers(paper["joint_state"], 2 if slides else 1),
        numbers(paper["axis_deg"], 1),
        numbers(paper["axis_distance"], 2),
    ]


def markdown(rows: list[list[str]]) -> list[str]:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return [lines[0], "|---" * len(rows[0]) + "|", *lines[1:]]


def milliseconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1000 * seconds:.1f}"


def table1(config: Config) -> list[str]:
    answer = EvalTable1(categories=config.categories, cache=config.cache).run().record
    rows = [["category", "method", *HEAD, "missing", "network, alignment, all (ms)"]]
    for line in answer["rows"]:
        times = ", ".join(milliseconds(line["seconds"][key]) for key in ("network", "refinement", "total"))
        rows.append([line["category"], NAMES[line["method"]], *cells(line), str(line["missing"]), times])
        if line["paper"]:
            times = f"-, -, {milliseconds(line['paper']['seconds'])}"
            rows.append(["", f"*paper*, {NAMES[line['method']].strip('*')}", *paper_cells(line), "", "", "", "", times])
    compared = [
        ["category", "ahead on joint state", "ahead on axis distance", "alignment over refinement", "end to end"]
    ]
    for name, found in answer["comparison"].items():
        if found:
            ahead = [{True: "yes", False: "no", None: "-"}[found[key]] for key in list(found)[:2]]
            times = [f"{found[key]:.1f}" if found[key] else "-" for key in list(found)[2:]]
            compared.append([name, *ahead, *times])
    lead = "OMAD refined against A-NCSH, and how many times as long A-NCSH takes:"
    machine = answer["rows"][0]["seconds"]["machine"]
    return [*markdown(rows), "", lead, "", *markdown(compared), "", f"Times: {machine}."]


def check_whole(left_out: list[dict[str, str]]) -> None:
    """A table that lacks what the page has does not take its place."""
    if left_out:
        raise InputError("; ".join(f"{row.get('category', '')} {row['method']}: {row['reason']}" for row in left_out))


def table2(config: Config) -> list[str]:
    command = EvalTable2(categories=config.categories, cache=config.cache / "table2", ablation=config.ablation)
    answer = command.run().record
    check_whole(answer["left_out"])
    rows = [["category", "keypoints", *HEAD]]
    for line in answer["rows"]:
        rows.append([line["category"], line["method"], *cells(line)])
        if line["paper"]:
            rows.append(["", f"*paper*, {line['method']}", *paper_cells(line), "", "", ""])
    return markdown(rows)


def ablation(config: Config) -> list[str]:
    command = EvalAblation(
        category=config.ablation_of,
        output=config.ablation,
        cache=config.cache,
        train=False,
        samples=config.samples,
    )
    answer = command.run().record
    rows = [[answer["ablation"], *HEAD, "refinement (ms)"]]
    for line in answer["rows"]:
        rows.append([line["method"], *cells(line), milliseconds(line["seconds"]["refinement"])])
    budget = f"{config.samples} views of {command.training_objects} objects each; their priors twice as many clouds"
    return [*markdown(rows), "", f"Trained ones, from the shipped backbone: {budget}."]


def main(config: Config) -> None:
    for name, make in {"table1": table1, "table2": table2, "ablation": ablation}.items():
        put(PAGE, name, make(config), config.categories == FIVE)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
