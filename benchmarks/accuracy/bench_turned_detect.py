"""How many objects of a table ``omad detect`` finds with a camera turned about its axis, with gravity and without.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_turned_detect.py [--scenes 8]

Scenes are those of ``bench_detect.py`` with other categories, which stand by themselves. Gravity is what the table
found in the frame of the level camera tells. An object is found where an answer of its category lies mostly on its
pixels and stands upright within 10 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro

from omad.applications.detection.detector import Detector
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.tabletop import Tabletop, draw_tabletop
from omad.estimation.categories.late import shipped_estimators
from omad.estimation.known import NOTHING_KNOWN, Known
from omad.geometry.camera import Camera
from omad.sensing.cutting.segmentation import things_before_planes
from omad.sensing.observation import Observation

SEED = 77
LEANING = np.cos(np.radians(10))
QUARTER = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
"""Takes points to the frame of the camera whose image NumPy's ``rot90`` gives."""


@dataclass
class Config:
    """What to measure."""

    scenes: int = 8
    categories: tuple[str, ...] = ("laptop", "lidded_box", "microwave", "stapler")
    turns: tuple[int, ...] = (0, 1, 2)
    """Of the camera, by 90 degrees each."""


def turned(camera: Camera, turns: int) -> Camera:
    """That of an image which ``rot90`` has turned so often."""
    for _ in range(turns):
        swapped = camera.height, camera.width, camera.fy, camera.fx, camera.cy, camera.width - 1 - camera.cx
        camera = Camera(*swapped)
    return camera


def count_found(detector: Detector, scene: Tabletop, up: np.ndarray, turns: int) -> int:
    """Objects of a scene that are found in its image turned so often; ``up`` (3,) in that camera's frame."""
    depth = np.ascontiguousarray(np.rot90(scene.depth, turns))
    answers = detector(Observation.from_depth(depth, turned(scene.camera, turns)))
    found = 0
    for placed in scene.objects:
        mask = np.rot90(placed.mask, turns)
        for one in answers:
            if one.estimate is None or one.category != placed.category or not placed.to_be_found:
                continue
            columns, rows = np.asarray(one.observation.pixels).T
            if mask[rows, columns].mean() > 0.7 and one.estimate.T_camera_base[:3, 1] @ up > LEANING:
                found += 1
                break
    return found


def main(config: Config) -> None:
    estimators = shipped_estimators()
    wanted, found = 0, {(turns, known): 0 for turns in config.turns for known in (False, True)}
    for number in range(config.scenes):
        scene = draw_tabletop(config.categories, (number, SEED), "test", ON)
        planes = things_before_planes(Observation.from_depth(scene.depth, scene.camera).points, 150).planes
        up = planes[planes[:, 1].argmin(), :3]
        wanted += sum(placed.category is not None and placed.to_be_found for placed in scene.objects)
        for turns, known in found:
            seen_up = np.linalg.matrix_power(QUARTER, turns) @ up
            detector = Detector(estimators, known=Known(gravity=-seen_up) if known else NOTHING_KNOWN)
            found[turns, known] += count_found(detector, scene, seen_up, turns)
    print(f"{wanted} objects")
    for (turns, known), count in found.items():
        print(f"camera turned by {90 * turns} degrees, gravity {'known' if known else 'not known'}: {count} found")


if __name__ == "__main__":
    main(tyro.cli(Config))
