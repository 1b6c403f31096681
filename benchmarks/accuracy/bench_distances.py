"""How often images that hold distances from the camera's centre in place of depth are told, and right ones taken for
such.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_distances.py [--scenes 60]

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
from omad.sensing.cutting.distances import hold_distances

ASKED = "table", "floor", "walled", "room"


@dataclass(frozen=True)
class Config:
    """What to measure."""

    scenes: int = 60
    """Of each kind."""


def told(scene: Tabletop) -> tuple[bool, bool]:
    """Whether the image is taken for one of distances: as it is, and as such."""
    rows, columns = np.nonzero(scene.depth)
    depth = scene.depth[rows, columns].astype(np.float64)
    points = scene.camera.backproject(np.stack([columns, rows], 1), depth)
    far = np.linalg.norm(points, axis=1, keepdims=True)
    return hold_distances(points.astype(np.float32)), hold_distances((points * far / depth[:, None]).astype(np.float32))


def main(config: Config) -> None:
    print("| scenes | told of distances | of depth |\n|---|---|---|")
    for number, (kind, (categories, largest, around)) in enumerate(KINDS.items()):
        if kind in ASKED:
            seeds = ((index, number) for index in range(config.scenes))
            drawn = (draw_tabletop(categories, seed, "test", ON, largest, surroundings=around) for seed in seeds)
            right, wrong = np.sum([told(scene) for scene in drawn], axis=0)
            print(f"| {kind} | {wrong} of {config.scenes} | {right} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
