"""How all figures look: colours, fonts, the grid of panels, small files."""

import colorsys
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from omad.common.files import write_atomic

INK, FAINT, RULE = "#22252b", "#6b7280", "#d5d9e0"
ESTIMATED, TRUE = "#c81e4a", "#111111"
"""Joint axes."""
METHOD_COLOURS = {"ancsh": "#8a8f98", "omad_initial": "#e08e2b", "omad_refined": "#2563c9"}
METHOD_NAMES = {"ancsh": "A-NCSH", "omad_initial": "OMAD, initial", "omad_refined": "OMAD, refined"}
OBJECT_COLOURS = (
    "#2563c9", "#e08e2b", "#2f9e5b", "#c81e4a", "#7c4dbd", "#8a5a3c",
    "#e377a8", "#5b6470", "#a8b820", "#1fb5c4", "#1b2a6b", "#f2c14e",
)  # fmt: skip
"""One an object; they repeat after the twelfth."""
WIDTH = 9.0
"""Inches: 8 points are 11 pixels where a page shows a figure 900 pixels wide."""
DPI = 140
COLOURS = 192
"""Of a picture's palette."""
_RC: Any = {
    "font.family": "DejaVu Sans", "font.size": 8, "text.color": INK, "grid.color": "#eceef2", "grid.linewidth": 0.8,
    "axes.edgecolor": RULE, "axes.labelcolor": INK, "axes.linewidth": 0.8,
    "axes.spines.top": False, "axes.spines.right": False,
    "xtick.color": FAINT, "xtick.labelsize": 7.5, "xtick.major.size": 2.5,
    "ytick.color": FAINT, "ytick.labelsize": 7.5, "ytick.major.size": 2.5,
}  # fmt: skip
styled = matplotlib.rc_context(_RC)
"""Decorates what draws a figure: Matplotlib's settings of these figures, for as long as it is drawn."""


def keypoint_colours(count: int) -> np.ndarray:
    """(count, 3): one colour an index, the same wherever it is drawn; neighbours in index are far apart in hue."""
    levels = ((0.50, 0.85), (0.66, 0.80), (0.38, 0.80))
    return np.array([colorsys.hls_to_rgb(i * 0.381966 % 1, *levels[i % len(levels)]) for i in range(count)])


@dataclass(frozen=True)
class Sheet:
    """A figure of rows and columns of panels with room for headers above and labels at the left; inches."""

    figure: Figure
    width: float
    """Of a panel."""
    height: float
    left: float
    top: float
    gap: tuple[float, float]
    """Between columns, and between rows."""

    @classmethod
    def of(
        cls, rows: int, columns: int, aspect: float, *, left: float = 0.28, top: float = 0.3, bottom: float = 0.26,
        gap: tuple[float, float] = (0.06, 0.06), right: float = 0.06,
    ) -> Self:  # fmt: skip
        """``aspect``: height of a panel over its width."""
        width = (WIDTH - left - right - gap[0] * (columns - 1)) / columns
        height = width * aspect
        total = top + rows * height + gap[1] * (rows - 1) + bottom
        return cls(Figure(figsize=(WIDTH, total), facecolor="white"), width, height, left, top, gap)

    def panel(self, row: int, column: int) -> Axes:
        x, y = self._corner(row, column)
        total = self.figure.get_figheight()
        return self.figure.add_axes((x / WIDTH, 1 - (y + self.height) / total, self.width / WIDTH, self.height / total))

    def header(self, column: int, text: str, last: int | None = None, above: float = 0.09) -> None:
        """Over a column, or over all columns from ``column`` to ``last``."""
        middle = column if last is None else (column + last) / 2
        x, y = self._corner(0, middle)
        self._text(x + self.width / 2, y - above, text, ha="center", va="bottom", fontsize=8.5)

    def label(self, row: int, text: str, ruled: bool = True) -> None:
        """Upright at the left of a row, smaller where it would not fit; ``ruled``: with a thin line between rows."""
        _, y = self._corner(row, 0)
        if row and ruled:
            at = 1 - (y - self.gap[1] / 2) / self.figure.get_figheight()
            self.figure.add_artist(Line2D([0.005, 0.995], [at, at], color=RULE, linewidth=0.8))
        size = min(8.5, 72 * self.height / (0.7 * len(text)))
        self._text(0.12, y + self.height / 2, text, ha="center", va="center", rotation=90, fontsize=size, weight="bold")

    def note(self, text: str) -> None:
        """A line at the foot of the figure."""
        self.figure.text(0.5, 0.06 / self.figure.get_figheight(), text, ha="center", va="bottom", color=FAINT)

    def _text(self, x: float, y: float, text: str, **style: Any) -> None:
        self.figure.text(x / WIDTH, 1 - y / self.figure.get_figheight(), text, **style)

    def _corner(self, row: int, column: float) -> tuple[float, float]:
        """Left and top of a panel, from the figure's top left corner."""
        return self.left + column * (self.width + self.gap[0]), self.top + row * (self.height + self.gap[1])


def save(figure: Figure, path: Path) -> None:
    """Write a PNG with a palette: a third of the size, and the eye sees no difference."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DPI, format="png")
    image = Image.open(buffer).convert("RGB")
    small = image.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    write_atomic(path, lambda temporary: small.save(temporary, optimize=True))
