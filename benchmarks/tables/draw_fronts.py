"""Depth images of unseen objects beside their fronts, and what the network that sees these says of them.

python benchmarks/tables/draw_fronts.py --output docs/figures/fronts.png
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro
from matplotlib import colormaps
from matplotlib.figure import Figure

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view
from omad.estimation.estimator import Estimator
from omad.evaluation.figures.style import save
from omad.model.fronts.network import shipped_front_net
from omad.model.fronts.seen import front_of

CATEGORIES = ("drawer_2", "drawer", "drawer_4", "drawer_5", "oven")
RELIEF = 3
"""Channel that is drawn: what stands out of what is around it."""
TOLD = 2


def main(output: Path, seed: int = 1) -> None:
    net, grey = shipped_front_net(), colormaps["gray"].with_extremes(bad="lightsteelblue")
    figure = Figure(figsize=(1.4 * len(CATEGORIES), 3.9), layout="constrained")
    panels = figure.subplots(2, len(CATEGORIES))
    for (above, below), name in zip(panels.T, CATEGORIES, strict=True):
        estimator = Estimator.from_pretrained(name, "cpu")
        category = estimator.category
        view = standard_view(generate(category, 0, "test", seed), category, (seed, 0), LEVELS["on"])
        estimate = estimator(view.observation())
        image = front_of(estimate, category, estimate.labelled.points)
        rows, columns = (np.flatnonzero((view.depth > 0).any(axis)) for axis in (1, 0))
        seen = view.depth[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        above.imshow(np.where(seen > 0, seen, np.nan), cmap="viridis_r")
        above.set_title(name, fontsize=7)
        below.imshow(np.where(image[0] > 0, image[RELIEF], np.nan)[::-1], cmap=grey)
        said = sorted(zip(np.exp(net.says(image[None])[0]), net.names, strict=True), reverse=True)
        below.set_title("\n".join(f"{100 * share:.0f} % {one}" for share, one in said[:TOLD]), fontsize=7)
    for panel in panels.flat:
        panel.set_axis_off()
    save(figure, output)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
