"""Measure retrieval with the shipped weights and write the paper's Table 3 into docs/retrieval.md.

    OMP_NUM_THREADS=1 python benchmarks/tables/make_retrieval_tables.py [--categories laptop drawer]

The table stands between ``<!-- table3 -->`` and ``<!-- end -->``. Signatures are kept in ``--cache`` as they come: a
stopped run goes on where it was, and a table is rewritten in minutes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from make_tables import FIVE, put

from omad.cli.evaluation.retrieval import EvalRetrieval, ViewsOfEach

PAGE = Path(__file__).parents[2] / "docs" / "retrieval.md"
METHODS = {
    "omad_keypoints": "**OMAD, keypoint distance**",
    "omad_three_views": "the same, three views a query",
    "omad_information": "OMAD, by information",
    "omad_whitened": "OMAD, whitened beta",
    "omad": "OMAD, beta",
    "omad_initial": "OMAD initial, beta",
    "siamese": "Siamese",
    "siamese_three_views": "Siamese, three views a query",
}
"""What methods are called in the table, in its order."""
HEAD = "| category | method | mAP@10 | NN | 1st tier | 2nd tier | across states | 50 objects | *paper* |"
SHARES = ("map_at_10", "nearest_neighbour", "first_tier", "second_tier")


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = FIVE
    """Of others, or of some of these, the table is printed, and the page stays."""
    objects: int = 50
    views: int = 100
    """Of each object."""
    draws: int = 20
    cache: Path = Path("runs/retrieval")


def table(answers: dict[str, dict[str, Any]], objects: int) -> list[str]:
    """Lines of the table, from what ``omad eval retrieval`` answers."""
    lines = [HEAD.replace("50 objects", f"{objects} objects"), "|---" * 9 + "|"]
    for category, found in answers.items():
        rows = [(label, found[name]) for name, label in METHODS.items() if name in found]
        for label, part in rows:
            paper = "" if part["paper"] is None else percent(part["paper"])
            scores = cells(part, part["large"], part["across_states"], f" ± {100 * part['map_at_10_std']:.1f}")
            lines.append(f"| {category}, {part['objects']} objects | {label} | {scores} | {paper} |")
        first = rows[0][1]
        chances = (part["chance"] for part in (first, first["large"], first["across_states"]))
        scores = cells(*chances, spread="")
        lines.append(f"| {category}, {first['objects']} objects | chance | {scores} | |")
    return lines


def cells(usual: dict[str, Any], large: dict[str, Any], across: dict[str, Any], spread: str) -> str:
    """All shares of one line."""
    first, *rest = (percent(usual[name]) for name in SHARES)
    return " | ".join([first + spread, *rest, percent(across["map_at_10"]), percent(large["map_at_10"])])


def percent(share: float) -> str:
    return f"{100 * share:.1f}"


def main(config: Config) -> None:
    answers: dict[str, dict[str, Any]] = {}
    for category in config.categories:
        command = EvalRetrieval(
            category=category,
            data=ViewsOfEach(objects=config.objects, views=config.views),
            draws=config.draws,
            cache=config.cache,
        )
        answers |= command.run().record
    put(PAGE, "table3", table(answers, config.objects), config.categories == FIVE)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
