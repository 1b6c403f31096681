"""Thumbnails of a catalogue's entries, and a ranking as a picture."""

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from omad.common.errors import as_line
from omad.common.incoming import read_image
from omad.objects.model import ObjectModel
from omad.output.contact_sheet import picture
from omad.output.picture import blank_panels
from omad.sensing.observation import Observation

from .index import Hit

SIZE = 224
"""Pixels across a thumbnail, where there is so much to see."""
COLUMNS = 6
WIDTH, HEIGHT, HEAD = 2.2, 2.8, 0.4
"""Inches of a panel with the title over it, and of the first row's title."""
MOST = 60
"""Entries in a picture."""
LETTERS = 34
"""Of a name that there is room for over a panel."""


def model_thumbnail(model: ObjectModel) -> bytes:
    """The object at rest, from its front and a little from the right and above."""
    return _png(picture(model, np.zeros(len(model.axes))))


def view_thumbnail(observation: Observation) -> bytes:
    """The object's points as the camera saw them, dark where they are far."""
    return _png(_seen(observation))


def ranking_figure(observations: Sequence[Observation], hits: Sequence[Hit], unit: str) -> Figure:
    """The query's views, then the entries found, nearest first, ``MOST`` of them; ``unit`` stands behind distances."""
    hits = hits[:MOST]
    count = len(observations) + len(hits)
    columns, rows = min(COLUMNS, count), -(-count // COLUMNS)
    fig, axes = blank_panels(rows, columns, (WIDTH * columns, HEIGHT * rows))
    axes = axes.ravel()
    for panel, observation in zip(axes, observations, strict=False):
        panel.imshow(_seen(observation))
        panel.set_title("query", fontsize=9, color="crimson")
    for number, (panel, hit) in enumerate(zip(axes[len(observations) :], hits, strict=False), 1):
        if hit.entry.thumbnail:
            panel.imshow(_read(hit.entry.thumbnail))
        mirror = " in the mirror" if hit.mirrored else ""
        panel.set_title(f"{number}. {_cut(hit.entry.name)}\n{hit.distance:.3g} {unit}{mirror}", fontsize=7)
    fig.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=1 - HEAD / (HEIGHT * rows), wspace=0.05, hspace=0.3)
    return fig


def _cut(name: str) -> str:
    """On one line, and without the middle of a long one, whose ends tell it from others."""
    line = as_line(name)
    return line if len(line) <= LETTERS else f"{line[: LETTERS // 2 - 1]}…{line[-LETTERS // 2 :]}"


def _seen(observation: Observation) -> np.ndarray:
    """(S, S, 3) of the points, the nearest one of every pixel, which are no smaller than the points lie apart."""
    points = observation.points[np.argsort(-observation.points[:, 2])].astype(np.float64)  # near ones are drawn last
    rays = points[:, :2] / np.maximum(points[:, 2:], 1e-6)
    low, high = rays.min(0), rays.max(0)
    size = min(SIZE, int(np.sqrt(len(points))) + 1)
    scale = 0.9 * (size - 1) / max(float((high - low).max()), 1e-9)
    column, row = np.rint((rays - (low + high) / 2) * scale + (size - 1) / 2).astype(int).clip(0, size - 1).T
    near, far = observation.depth_range
    light = (1 - (points[:, 2] - near) / max(far - near, 1e-9)).clip(0, 1)
    image = np.ones((size, size, 3))
    image[row, column] = 0.15 + 0.6 * light[:, None] * np.array([0.6, 0.85, 1.0])
    return image


def _png(image: np.ndarray) -> bytes:
    """A small PNG of (H, W, 3) in [0, 1]."""
    stored = Image.fromarray(np.rint(255 * image.clip(0, 1)).astype(np.uint8))
    stored.thumbnail((SIZE, SIZE))
    buffer = io.BytesIO()
    stored.quantize(32).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def _read(thumbnail: bytes) -> np.ndarray:
    return read_image(thumbnail, "a thumbnail of the index", "RGB", cure="build the index anew")
