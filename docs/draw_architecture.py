"""Draw the rooms of the code as they are: ``python docs/draw_architecture.py`` writes docs/figures/architecture.png.

Rooms stand from top to bottom as they may import each other; a dot says how many modules of a room import a lower one.
"""

from __future__ import annotations

import ast
import io
import textwrap
import tomllib
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

DOCS = Path(__file__).parent
SOURCE = DOCS.parent / "src" / "omad"


def rooms() -> list[str]:
    """Names from top to bottom, as the contract of import-linter states them."""
    settings = tomllib.loads((DOCS.parent / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    return [layer.rpartition(".")[2] for layer in layers]


def imported(file: Path) -> set[str]:
    """Rooms that a module imports."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and not node.level and (node.module or "").startswith("omad."):
            found.add(node.module.split(".")[1])
    return found


def draw() -> Figure:
    """A row a room: what it is for, what stands in it, and which lower rooms it uses."""
    names = rooms()
    fig = Figure(figsize=(14, 0.98 * len(names) + 1), facecolor="white")
    axes = fig.subplots()
    axes.set_axis_off()
    axes.set_xlim(0, 14)
    axes.set_ylim(len(names) + 0.1, -1.0)
    for row, name in enumerate(names):
        folder = SOURCE / name
        files = sorted(folder.rglob("*.py"))
        lines = sum(len(file.read_text().splitlines()) for file in files)
        about = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
        inside = sorted(
            {f"{path.name}/" if path.is_dir() else path.stem for path in folder.iterdir() if path.name[0] not in "_."}
        )
        axes.fill([0, 9.6, 9.6, 0], [row + 0.04, row + 0.04, row + 0.94, row + 0.94], color="#eef2f8", zorder=0)
        axes.text(0.15, row + 0.42, name, fontsize=14, weight="bold", va="center", color="#1f3a68")
        axes.text(0.15, row + 0.76, f"{lines:,} lines", fontsize=8, va="center", color="#667")
        first = textwrap.shorten(about.splitlines()[0].replace("``", ""), 110)
        axes.text(1.9, row + 0.26, first, fontsize=9, va="center", style="italic", color="#334")
        axes.text(1.9, row + 0.64, textwrap.fill(", ".join(inside), 112), fontsize=8.5, va="center", color="#111")
        uses = [imported(file) for file in files]
        for column, other in enumerate(names):
            count = sum(other in each for each in uses)
            x = 10.1 + 0.32 * column
            if column == row:
                axes.text(x, row + 0.5, "·", ha="center", va="center", color="#99a")
            elif count:
                axes.scatter([x], [row + 0.5], s=14 + 11 * min(count, 30), color="#c33" if column < row else "#4678b8")
    for column, name in enumerate(names):
        axes.text(10.1 + 0.32 * column, -0.08, name, rotation=60, fontsize=8, ha="left", va="bottom", color="#1f3a68")
    axes.text(0, -0.45, "src/omad: a room imports only from the rooms below it", fontsize=13, va="center")
    fig.subplots_adjust(0.01, 0.01, 0.99, 0.99)
    return fig


if __name__ == "__main__":
    drawn = io.BytesIO()
    draw().savefig(drawn, dpi=80)
    few = Image.open(drawn).convert("RGB").quantize(64, dither=Image.Dither.NONE)
    few.save(DOCS / "figures" / "architecture.png", optimize=True)
