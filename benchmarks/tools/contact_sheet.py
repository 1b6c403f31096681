"""Procedural objects beside other people's models, at random states from random sides: what does a generator lack?

    python benchmarks/tools/contact_sheet.py scissors [--models FOLDER] [--output scissors.png]

The foreign models come first. Parts have colours of their own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tyro
from matplotlib.figure import Figure

from omad.data.procedural import generate
from omad.data.rendering.viewpoints import random_states
from omad.data.urdf_import.folder import load_folder
from omad.objects.category_file import get_category
from omad.output.contact_sheet import picture
from omad.output.picture import save

COLUMNS = 6


def main(
    category: tyro.conf.Positional[str], models: Path | None = None, count: int = 25, output: Path | None = None
) -> None:
    spec = get_category(category)
    shown = load_folder(models, spec).models if models else []
    shown += [generate(spec, index, "test") for index in range(count)]
    rng = np.random.default_rng(0)
    rows = -(-len(shown) // COLUMNS)
    fig = Figure(figsize=(2.2 * COLUMNS, 2.3 * rows), facecolor="white")
    for panel in fig.subplots(rows, COLUMNS, squeeze=False).flat:
        panel.set_axis_off()
    for panel, model in zip(fig.axes, shown, strict=False):
        azimuth = rng.uniform(-spec.views.azimuth, spec.views.azimuth)
        elevation = rng.uniform(*spec.views.elevation)
        states = random_states(model.limits, spec.joints, rng)
        panel.imshow(picture(model, states, azimuth, min(elevation, 1.5)))
        panel.set_title(model.name, fontsize=7)
    fig.tight_layout()
    save(fig, output or Path(f"{category}.png"))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
