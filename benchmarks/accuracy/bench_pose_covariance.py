"""Whether the base is where ``Estimate.covariance`` says.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_pose_covariance.py [--categories laptop drawer]
        [--objects 100] [--json]

Noisy standard views of unseen procedural objects, one each. "within" is the share of the errors, about and along the
camera's three axes, that are below one standard deviation: 0.68 if the covariance were true. "times" is the median
error in units of what it would then be.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import tyro
from scipy.spatial.transform import Rotation

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view
from omad.estimation.estimator import Estimator
from omad.model.checkpoint import shipped_categories

USUAL = NormalDist().inv_cdf(0.75)
"""Median of a normal error, standard deviations."""
BLOCKS = {"rotation": slice(3), "translation": slice(3, 6)}


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    categories: tuple[str, ...] = tuple(shipped_categories())
    objects: int = 100
    seed: int = 37
    json: bool = False


def main(config: Config) -> None:
    answer = {name: measure(name, config) for name in config.categories}
    if config.json:
        print(json.dumps(answer))
        return
    for name, found in answer.items():
        print(f"{name:24}" + "   ".join(f"{key} {value:.2f}" for key, value in found.items()))


def measure(name: str, config: Config) -> dict[str, float]:
    estimator = Estimator.from_pretrained(name, device="cpu")
    category, off = estimator.category, []
    for index in range(config.objects):
        model = generate(category, index, "test", config.seed)
        view = standard_view(model, category, (config.seed, index), LEVELS["on"])
        estimate = estimator(view.observation())
        turned = estimate.T_camera_base[:3, :3] @ view.T_camera_base[:3, :3].T
        moved = estimate.T_camera_base[:3, 3] - view.T_camera_base[:3, 3]
        errors = np.concatenate([Rotation.from_matrix(turned).as_rotvec(), moved])
        off.append(np.abs(errors) / np.sqrt(estimate.covariance.diagonal()[:6]))
    found = {}
    for what, block in BLOCKS.items():
        ratios = np.array(off)[:, block]
        found |= {f"{what} within": float((ratios < 1).mean()), f"{what} times": float(np.median(ratios) / USUAL)}
    return found


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
