"""How far wrong depth turns surfaces by itself: what is left for an estimator to get right.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_bent_depth.py [--category laptop] [--views 40]

Of a joint whose two parts are flat: the angle between the planes that fit their pixels best, which pixels being known,
against that of the same pixels with exact depth; beside the joint state errors of the shipped weights. Means over the
views of ``omad eval robustness``, degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import tyro

from omad.data.procedural import generate
from omad.data.rendering.spoils.scenes import draw_scene
from omad.data.rendering.spoils.spoiling import spoilt, within_range
from omad.data.rendering.standard_views import View, view_seed
from omad.estimation.estimator import Estimator
from omad.evaluation.robustness.rows import ROWS

OBJECTS, SEED = 20, 0
WRONG = ("noise", "smooth-1", "smooth-3", "active-stereo", "coded-light", "speckle", "time-of-flight")
ROUNDS, KEPT, LEAST = 4, 2.5, 0.002
"""Of a plane's fit: how often points are left out that are farther off than so many of its deviations, or metres."""
FEWEST = 50
"""Pixels of a plane."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    category: str = "laptop"
    views: int = 40


def opening(view: View) -> float:
    """Radians between the planes of the first two parts, whose pixels are known; NaN where one is hardly seen."""
    normals = []
    for part in (0, 1):
        on = (view.labels == part) & (view.depth > 0)
        if np.count_nonzero(on) < FEWEST:
            return np.nan
        seen = view.camera.backproject(np.argwhere(on)[:, ::-1], view.depth[on])
        off = np.zeros(len(seen))
        for _ in range(ROUNDS):
            kept = np.abs(off) <= max(KEPT * 1.48 * np.median(np.abs(off)), LEAST)
            centre = seen[kept].mean(0)
            normals[part:] = [np.linalg.svd(seen[kept] - centre, full_matrices=False)[2][2]]
            off = (seen - centre) @ normals[part]
    return float(np.arccos(min(abs(normals[0] @ normals[1]), 1.0)))


def main(config: Config) -> None:
    estimator = Estimator.from_pretrained(config.category, "cpu")
    category = estimator.category
    models = [generate(category, index, "test", SEED) for index in range(OBJECTS)]
    print(f"{config.category}: views, planes turned by wrong depth, joint state error (degrees)")
    for row in WRONG:
        spoil, rows = ROWS[row].spoil, []
        for index in range(config.views):
            drawn = view_seed(index, OBJECTS, SEED)
            scene = draw_scene(models[drawn[1]], category, drawn, spoil.staging)
            if not within_range(scene, spoil):
                continue
            exact, view = spoilt(scene, replace(spoil, noise="off", waves=0.0)).view, spoilt(scene, spoil).view
            turned = abs(opening(view) - opening(exact))
            rows.append([turned, abs(estimator(view.observation()).joint_states[0] - view.states[0])])
        print(f"  {row:>15} {len(rows):4d}  " + "  ".join(f"{value:5.2f}" for value in np.degrees(np.nanmean(rows, 0))))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
