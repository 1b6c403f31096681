"""The committed benchmark of the shipped weights, as ``benchmarks/tables/make_golden.py`` writes it."""

from pathlib import Path

import numpy as np

from omad.sensing.observation import Observation

FOLDER, STEP = Path(__file__).parents[1] / "golden", 2e-4


def golden(name: str) -> tuple[list[Observation], dict[str, np.ndarray]]:
    """Clouds of a category's views, which lie in its file in steps of so many metres, and all that it holds."""
    with np.load(FOLDER / f"golden_{name}.npz") as file:
        data = dict(file)
    clouds = data["points"].transpose(0, 2, 1) + data["middle"][:, None]
    return [Observation.from_points(points * STEP) for points in clouds], data
