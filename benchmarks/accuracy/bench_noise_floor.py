"""How far off joint states are in smooth noise where all but they and the pose is known: what depth alone tells.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_noise_floor.py [--categories laptop] [--objects 40]

Views are the clean ones of the robustness table, one of each unseen procedural object. The true object's depth image is
linearised in pose and joint states, and these are fitted to the smooth error of the table by plain least squares, over
the pixels that show the same surface before and after a small step. Neither shape nor outlines are in it: an estimator
that has to find the shape, too, is farther off, one that heeds outlines may be nearer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.rasteriser import render
from omad.data.rendering.smooth_fields import smooth_field
from omad.data.rendering.spoils.depths import LENGTH
from omad.data.rendering.spoils.scenes import Scene, draw_scene
from omad.data.rendering.spoils.spoil import Staging
from omad.data.rendering.standard_views import view_seed
from omad.evaluation.robustness.rows import ROWS
from omad.geometry.rigid import rigid
from omad.objects.category_file import get_category
from omad.objects.model import ObjectModel

STEP = 1e-3
"""Radians and metres of a small step."""
JUMP = 0.01
"""Metres: where depth changes by more, another surface is seen."""
DRAWS = 4
"""Random errors a view."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    categories: tuple[str, ...] = ("laptop", "eyeglasses", "dishwasher", "scissors", "drawer")
    objects: int = 40
    rows: tuple[str, ...] = ("smooth-1", "smooth-3")


def scenes(config: Config, name: str) -> Iterator[tuple[ObjectModel, Scene]]:
    category = get_category(name)
    for index in range(config.objects):
        seed = view_seed(index, config.objects, 0)
        model = generate(category, seed[1], "test")
        try:
            yield model, draw_scene(model, category, seed, Staging())
        except InputError:  # seen so, it shows too little
            continue


def depth_after(model: ObjectModel, scene: Scene, step: np.ndarray) -> np.ndarray:
    """(H, W) of the object after a step (6 + J,): turned, moved, its joints moved."""
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    T = scene.T_camera_base
    moved = rigid(turn @ T[:3, :3], T[:3, 3] + step[3:6])
    return render(model, scene.states + step[6:], moved, scene.camera).depth


def slopes(model: ObjectModel, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) bool of the pixels that count, and (N, 6 + J) by how much their depth changes with each unknown."""
    count = 6 + len(scene.states)
    before = depth_after(model, scene, np.zeros(count))
    counts, found = before > 0, []
    for step in STEP * np.eye(count):
        there, back = depth_after(model, scene, step), depth_after(model, scene, -step)
        for depth in (there, back):
            counts &= (depth > 0) & (np.abs(depth - before) < JUMP)
        found.append((there - back) / (2 * STEP))
    return counts, np.stack([slope[counts] for slope in found], 1)


def main(config: Config) -> None:
    print(f"| | {' | '.join(config.rows)} |\n|---{'|---' * len(config.rows)}|")
    for name in config.categories:
        errors: dict[str, list[np.ndarray]] = {row: [] for row in config.rows}
        for number, (model, scene) in enumerate(scenes(config, name)):
            counts, by_unknowns = slopes(model, scene)
            rng = np.random.default_rng(number)
            for _ in range(DRAWS):
                field = smooth_field(counts.shape, LENGTH, rng)[counts] * scene.truth.diagonal
                off = np.abs(np.linalg.lstsq(by_unknowns, field)[0][6:])
                for row in config.rows:
                    errors[row].append(ROWS[row].spoil.waves * off)
        turning = get_category(name).turning
        scale, unit = (np.degrees(1), "°") if all(turning) else (100, " cm")
        told = [f"{scale * np.mean(e):.2g}{unit} / {scale * np.median(e):.2g}{unit}" for e in errors.values()]
        print(f"| {name} | {' | '.join(told)} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
