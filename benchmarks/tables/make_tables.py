"""Measure the shipped weights and write the docs' tables of accuracy.

    OMP_NUM_THREADS=1 python benchmarks/tables/make_tables.py [--models FOLDER] [--categories laptop drawer]

``--models``: a folder with one sub-folder of URDF or PartNet-Mobility models a category (``FOLDER/laptop/...``);
without it the table of foreign models stays as it is, as do rows of categories that are not asked for. Tables stand
between ``<!-- name -->`` and ``<!-- end -->`` in docs/results.md, a short one in the README. Answers are kept in
``--cache`` and made anew only where they are missing. How far answers go towards surfaces is written into
docs/surfaces.md as the weights have it.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from omad.cli.evaluation.pose import EvalPose
from omad.cli.options import Views
from omad.common.files import write_atomic, write_json
from omad.model.checkpoint import find_weights, shipped_categories
from omad.model.surfaces.bank import FILE
from omad.model.surfaces.shares import Shares
from omad.objects.category_file import get_category

ROOT = Path(__file__).parents[2]
PAGE, SURFACES, README = ROOT / "docs" / "results.md", ROOT / "docs" / "surfaces.md", ROOT / "README.md"
PAPER = {
    "laptop": ("3.3", "3.7", "0.03"),
    "eyeglasses": ("4.9; 5.2", "4.2; 4.6", "0.05; 0.04"),
    "dishwasher": ("3.7", "4.6", "0.09"),
    "scissors": ("3.2", "2.7", "0.05"),
    "drawer": ("0.11 u; 0.11 u; 0.09 u", "3.2", "-"),
}
"""The paper's Table 1, refined: joint state, axis angle, axis distance."""
HEAD = "joint state (° or u) | axis angle (°) | axis distance (u) | base rotation (°) | within 5°, 5 % | flipped |"


@dataclass(frozen=True)
class Config:
    """What to measure."""

    models: Path | None = None
    categories: tuple[str, ...] = ()
    """Default: all that have weights, the paper's first."""
    cache: Path = Path("runs/tables")
    views: int = 200
    """On procedural objects, each of another one: views of one err alike."""
    views_a_model: int = 100
    """On each foreign model."""


def measured(
    config: Config, category: str, source: str, noisy: bool, views: int, to_surface: bool = False
) -> dict[str, Any]:
    """The answer of ``omad eval pose``, from the cache where it is there."""
    kind = "procedural" if source == "procedural" else "models"
    noise = "on" if noisy else "off"
    file = config.cache / f"{category}-{kind}-{noise}-{views}{'-surface' * to_surface}.json"
    data = Views(source=source, views=views, depth_noise=noise)
    return kept(file, lambda: EvalPose(category=category, data=data, to_surface=to_surface).run().record)


def kept(file: Path, measure: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What was measured, from the ``file`` where it is there."""
    if not file.is_file():
        print(file.stem, file=sys.stderr)
        write_json(file, measure())
    return json.loads(file.read_text())


def cells(errors: dict[str, Any], unit: float) -> str:
    """Mean / median of every joint, as one line of the table."""
    states = [
        spread(angle, 1, 1) if angle else spread(length, 1 / unit, 3) + " u"
        for angle, length in zip(errors["joint_state_error_deg"], errors["joint_state_error"], strict=True)
    ]
    distances = [spread(e, 1 / unit, 3) if e else "-" for e in errors["axis_distance"]]
    columns = [
        each(states),
        each([spread(e, 1, 1) for e in errors["axis_error_deg"]]),
        each(distances),
        spread(errors["rotation_error_deg"][0], 1, 1),
        f"{errors['within_5deg_5percent']:.0%}",
        f"{errors['flipped']:.1%}",
    ]
    return " | ".join(columns) + " |"


def each(values: list[str]) -> str:
    """Values of all joints, once where all are the same."""
    return values[0] if len(set(values)) == 1 else "; ".join(values)


def spread(error: dict[str, float], factor: float, digits: int) -> str:
    return f"{factor * error['mean']:.{digits}f} / {factor * error['median']:.{digits}f}"


def procedural_table(config: Config) -> list[str]:
    lines = [f"| category | noise | | {HEAD}", "|---" * 9 + "|"]
    for name in config.categories:
        for noisy in (False, True):
            answer = measured(config, name, "procedural", noisy, config.views)
            for stage in ("initial", "refined"):
                row = cells(answer[stage], answer["metres_per_unit"])
                lines.append(f"| {name} | {'on' if noisy else 'off'} | {stage} | {row}")
        answer = measured(config, name, "procedural", True, config.views, to_surface=True)
        lines.append(f"| {name} | on | to surface | {cells(answer['refined'], answer['metres_per_unit'])}")
        if name in PAPER:
            state, axis, distance = PAPER[name]
            lines.append(f"| {name} | | *paper*, refined | {state} | {axis} | {distance} | | | |")
    return lines


def short_table(config: Config) -> list[str]:
    """Means of refined answers to noisy views, a line a category."""
    kinds = "joint states | axis angle | within 5°, 5 %"
    lines = [f"| category | {kinds} | *to the surface:* {kinds} | the paper: state, angle |", "|---" * 8 + "|"]
    for name in config.categories:
        both = [measured(config, name, "procedural", True, config.views, to_surface=each) for each in (False, True)]
        refined, to_surface = (short_cells(answer["refined"], answer["metres_per_unit"]) for answer in both)
        state, axis, _ = PAPER.get(name, ("", "", ""))
        length = f" ({both[0]['metres_per_unit']:.2f} m)" if " u" in refined else ""
        lines.append(f"| {name}{length} | {refined} | {to_surface} | {f'{state}, {axis}' if state else ''} |")
    return lines


def short_cells(errors: dict[str, Any], unit: float) -> str:
    """Means of states and of the worst joint's axis, and the share within 5 degrees and 5 %."""
    both = zip(errors["joint_state_error_deg"], errors["joint_state_error"], strict=True)
    states = ", ".join(f"{a['mean']:.1f}°" if a else f"{b['mean'] / unit:.3f} u" for a, b in both)
    axes = max(error["mean"] for error in errors["axis_error_deg"])
    return f"{states} | {axes:.1f}° | {errors['within_5deg_5percent']:.0%}"


def models_table(config: Config, models: Path) -> tuple[list[str], list[str]]:
    """Rows of the models that are usable, and why the others are not."""
    lines, refused = [f"| object | noise | {HEAD}", "|---" * 8 + "|"], []
    for name in config.categories:
        source = models / name
        if not source.is_dir():
            continue
        count = len(measured(config, name, str(source), False, 1)["refused"])
        views = config.views_a_model * (sum(path.is_dir() for path in source.iterdir()) - count)
        for noisy, to_surface in ((False, False), (True, False), (True, True)):
            answer = measured(config, name, str(source), noisy, views, to_surface)
            noise = ("on" if noisy else "off") + ", to surface" * to_surface
            for entry in answer["by_object"]:
                row = cells(entry["refined"], answer["metres_per_unit"])
                lines.append(f"| {name} {entry['object']} | {noise} | {row}")
        reasons = ((r["name"], r["reason"].split(": ", 1)[-1]) for r in answer["refused"])
        refused += [f"- {name} {model}: {reason}" for model, reason in reasons]
    return lines, refused


def shares_table() -> list[str]:
    """How far answers of the shipped weights go towards their surfaces, and the mean errors that it was found by."""
    lines = ["| | views | base and shape | joints | joint states: keypoints, fit, taken |", "|---" * 5 + "|"]
    for name in shipped_categories():
        category, folder = get_category(name), find_weights(name)
        with np.load(folder / FILE) as file:
            shares = Shares.among(dict(file), len(category.joints))
        assert shares is not None
        per_unit = np.where(category.turning, 180 / np.pi, category.metres_per_unit)
        kinds = [(".1f", "°") if turning else (".3f", " m") for turning in category.turning]
        told = [
            ", ".join(f"{error:{digits}}{unit}" for error, (digits, unit) in zip(row * per_unit, kinds, strict=True))
            for row in shares.errors[:, 1:]
        ]
        base, *joints = (f"{share:g}" for share in shares.taken)
        lines.append(f"| {name} | {shares.views} | {base} | {', '.join(joints)} | {'; '.join(told)} |")
    return lines


def replaced(text: str, name: str, lines: list[str], some: tuple[str, ...] = ()) -> str:
    """``text`` with what stands between the marks of ``name`` exchanged; where ``lines`` are of ``some`` categories,
    only theirs."""
    pattern = re.compile(rf"(<!-- {name} -->\n)((?:.*\n)*?)(<!-- end -->)")

    def exchanged(match: re.Match[str]) -> str:
        after = put_in(match[2].splitlines(), lines, some) if some else lines
        return match[1] + "\n".join(after) + "\n" + match[3]

    return pattern.sub(exchanged, text)


FIVE = tuple(PAPER)
"""The paper's categories."""


def put(page: Path, name: str, lines: list[str], whole: bool) -> None:
    """Exchange a table of a page; one that is not of all categories on the page is printed, and the page stays."""
    if whole:
        text = replaced(page.read_text(), name, lines)
        write_atomic(page, lambda path: path.write_text(text))
    else:
        print("\n".join(lines))


def put_in(before: list[str], lines: list[str], some: tuple[str, ...]) -> list[str]:
    """Rows of ``some`` categories where they were ``before``, new ones at the end."""
    rows = {name: [line for line in lines if whose(line) == name] for name in some}
    after = list[str]()
    for line in before:
        after += rows.pop(whose(line), []) if whose(line) in some else [line]
    return [*after, *chain(*rows.values())]


def in_order() -> tuple[str, ...]:
    """Categories with weights, the paper's first."""
    return (*PAPER, *(name for name in shipped_categories() if name not in PAPER))


def whose(line: str) -> str:
    """Category that a row begins with, or a line of a list."""
    return line.split()[1] if line.startswith(("| ", "- ")) else ""


def main(config: Config) -> None:
    some = config.categories
    config = replace(config, categories=some or in_order())
    short = replaced(README.read_text(), "accuracy", short_table(config), some)
    write_atomic(README, lambda path: path.write_text(short))
    text = replaced(PAGE.read_text(), "procedural", procedural_table(config), some)
    if config.models is not None:
        rows, refused = models_table(config, config.models)
        text = replaced(replaced(text, "models", rows, some), "refused", refused, some)
    write_atomic(PAGE, lambda path: path.write_text(text))
    shares = replaced(SURFACES.read_text(), "shares", shares_table())
    write_atomic(SURFACES, lambda path: path.write_text(shares))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
