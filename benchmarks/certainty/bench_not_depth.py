"""How often images that hold distances from the camera's centre or inverse depth in place of depth are told, and right
ones taken for such.

    OMP_NUM_THREADS=1 python benchmarks/certainty/bench_not_depth.py [--scenes 60]

Scenes are those of ``bench_detect.py``: three to six unseen objects on a table, a floor, a table beside a wall or a
floor before one, boxes and cans among them, with camera noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro
from bench_detect import KINDS

from omad.data.rendering.depth_noise import ON
from omad.data.rendering.tabletop import Tabletop, draw_tabletop
from omad.sensing.cutting.not_depth import DISTANCES, INVERSE, what_else

ASKED = "table", "floor", "walled", "room"


@dataclass(frozen=True)
class Config:
    """What to measure."""

    scenes: int = 60
    """Of each kind."""


def told(scene: Tabletop) -> tuple[bool, bool, bool]:
    """Whether the image is taken for something else: as it is; and for what it holds: distances, inverse depth."""
    rows, columns = np.nonzero(scene.depth)
    depth = scene.depth[rows, columns].astype(np.float64)
    rays = scene.camera.backproject(np.stack([columns, rows], 1), np.ones(len(depth)))
    held = depth, depth * np.linalg.norm(rays, axis=1), 1 / depth
    right, distances, inverse = (what_else((rays * numbers[:, None]).astype(np.float32)) for numbers in held)
    return right is not None, distances is DISTANCES, inverse is INVERSE


def main(config: Config) -> None:
    print("| scenes | told of distances | of inverse depth | of depth |\n|---|---|---|---|")
    for number, (kind, (categories, largest, around)) in enumerate(KINDS.items()):
        if kind in ASKED:
            seeds = ((index, number) for index in range(config.scenes))
            drawn = (draw_tabletop(categories, seed, "test", ON, largest, surroundings=around) for seed in seeds)
            right, distances, inverse = np.sum([told(scene) for scene in drawn], axis=0)
            print(f"| {kind} | {distances} of {config.scenes} | {inverse} | {right} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
