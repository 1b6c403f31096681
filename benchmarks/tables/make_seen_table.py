"""Joint state errors by how much is seen of the parts that a joint links: the table of docs/results.md.

    OMP_NUM_THREADS=1 python benchmarks/tables/make_seen_table.py [--categories stapler suitcase] [--views 200]

Noisy views of 20 objects a category. Of a joint's two parts the one counts of which less is seen, by its share of
the object's pixels: a suitcase behind its own lid, say. Rows of categories that are not asked for stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro
from bench_hidden import joint_errors, pixels
from make_tables import PAGE, PAPER, replaced
from tqdm import tqdm

from omad.common.files import write_atomic
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_views
from omad.estimation.estimator import Estimator
from omad.model.checkpoint import shipped_categories
from omad.objects.category import Category

OBJECTS, SEED = 20, 0
EDGES = (0.0, 0.02, 0.05, 0.1, 1.0)
"""Of the shares that the columns of the table stand for."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = ()
    """Default: all that have weights, the paper's first."""
    views: int = 200
    """Of each category."""


def measured(name: str, count: int) -> tuple[Category, np.ndarray, np.ndarray]:
    """Of all joints of all views how much is seen of their parts, and their errors (degrees, category units)."""
    estimator = Estimator.from_pretrained(name, "cpu")
    category = estimator.category
    models = [generate(category, index, "test", SEED) for index in range(OBJECTS)]
    child = np.arange(1, len(category.parts))
    parent = np.array([joint.parent for joint in category.joints])
    shares, errors = list[np.ndarray](), list[np.ndarray]()
    for view in tqdm(standard_views(models, category, count, SEED, LEVELS["on"]), desc=name, total=count):
        seen = pixels(view, len(category.parts))
        shares.append(np.minimum(seen[child], seen[parent]) / seen.sum())
        errors.append(joint_errors(estimator, view))
    return category, np.concatenate(shares), np.concatenate(errors)


def row(category: Category, share: np.ndarray, error: np.ndarray) -> str:
    """A line of the table; in brackets the share of joints."""
    unit, digits = ("°", 1) if category.turning[0] else (" u", 3)
    cells = [f"{error.mean():.{digits}f}{unit}"]
    for low, high in zip(EDGES[:-1], EDGES[1:], strict=True):
        some = (share >= low) & ((share < high) | (high == EDGES[-1]))
        cells.append(f"{error[some].mean():.{digits}f}{unit} ({some.mean():.0%})" if some.any() else "-")
    return f"| {category.name} | {' | '.join(cells)} |"


def main(config: Config) -> None:
    shipped = shipped_categories()
    names = config.categories or (*PAPER, *(name for name in shipped if name not in PAPER))
    for name in names:
        line = row(*measured(name, config.views))
        print(line, flush=True)
        text = replaced(PAGE.read_text(), "seen", [line], (name,))
        write_atomic(PAGE, lambda path, text=text: path.write_text(text))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
