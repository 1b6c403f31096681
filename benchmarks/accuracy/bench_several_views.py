"""What a second and a third view of the same moment bring, and whether the answer knows.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_several_views.py [--categories laptop drawer]
        [--objects 50] [--json]

Noisy views of unseen procedural objects, three of each from random standard viewpoints. One view: all three; two: all
pairs; three: all together. Joint states' errors are in degrees or category units; "held" is the share of true states in
the 90 % interval; "turned" that of answers whose base is more than 30 degrees off. Then how alike two views' errors are
(in standard deviations, at most 3 of them), by the angle between the views.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import tyro

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import View, views_together
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.model.checkpoint import shipped_categories

VIEWS = 3
ANGLES = (0, 20, 40, 60, 90, 180)
"""Degrees; borders of what is taken together."""


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    categories: tuple[str, ...] = tuple(shipped_categories())
    objects: int = 50
    seed: int = 31
    json: bool = False


def main(config: Config) -> None:
    answer = {name: measure(name, config) for name in config.categories}
    if config.json:
        print(json.dumps(answer))
        return
    for name, found in answer.items():
        print(name)
        for row in found["rows"]:
            print("  " + "  ".join(f"{key} {value:.3g}" for key, value in row.items()))
        print("  errors alike: " + ", ".join(f"{span} {value:.2f}" for span, value in found["alike"].items()))


def measure(name: str, config: Config) -> dict[str, Any]:
    estimator = Estimator.from_pretrained(name, device="cpu")
    category = estimator.category
    per_unit = np.where(category.turning, 180 / np.pi, 1 / category.metres_per_unit)
    found: list[list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]] = [[] for _ in range(VIEWS)]
    angles, products, squares = [], [], []
    for index in range(config.objects):
        model = generate(category, index, "test", config.seed)
        views = views_together(model, category, (config.seed, index), VIEWS, LEVELS["on"])
        observations = [view.observation() for view in views]
        T_world_camera = np.linalg.inv([view.T_camera_base for view in views])
        for count in range(1, VIEWS + 1):
            for chosen in combinations(range(VIEWS), count):
                some = [observations[i] for i in chosen]
                first = estimator(some, T_world_camera=T_world_camera[list(chosen)])[0]
                found[count - 1].append(compare(first, views[chosen[0]], per_unit))
        alone = [np.clip(off / std, -3, 3) for off, std, *_ in found[0][-VIEWS:]]
        for a, b in combinations(range(VIEWS), 2):
            lines = [T_world_camera[i, :3, 3] / np.linalg.norm(T_world_camera[i, :3, 3]) for i in (a, b)]
            angles.append(np.degrees(np.arccos(np.clip(lines[0] @ lines[1], -1, 1))))
            products.append(np.mean(alone[a] * alone[b]))
            squares.append(np.mean([alone[a] ** 2, alone[b] ** 2]))
    place = np.digitize(angles, ANGLES)
    alike = {
        f"{low} to {high}": float(np.array(products)[place == i].sum() / np.array(squares)[place == i].sum())
        for i, (low, high) in enumerate(zip(ANGLES, ANGLES[1:], strict=False), 1)
        if (place == i).any()
    }
    return {"rows": [summary(number, rows) for number, rows in enumerate(found, 1)], "alike": alike}


def compare(estimate: Estimate, view: View, per_unit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Errors, standard deviations and half widths of the 90 % intervals of the joint states, (J,) each, and degrees by
    which the base is turned."""
    std = np.array([joint.state_std for joint in estimate.joints])
    half = np.ptp([joint.interval(0.9) for joint in estimate.joints], axis=1) / 2
    R = estimate.T_camera_base[:3, :3].T @ view.T_camera_base[:3, :3]
    turned = np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))
    return (estimate.joint_states - view.states) * per_unit, std * per_unit, half * per_unit, float(turned)


def summary(views: int, rows: list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]) -> dict[str, float]:
    off, std, half, turned = (np.array(column) for column in zip(*rows, strict=True))
    return {
        "views": views,
        "mean": float(np.abs(off).mean()),
        "median": float(np.median(np.abs(off))),
        "p90": float(np.percentile(np.abs(off), 90)),
        "std": float(std.mean()),
        "held": float((np.abs(off) <= half).mean()),
        "base_deg": float(np.median(turned)),
        "turned": float((turned > 30).mean()),
    }


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
