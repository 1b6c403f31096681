"""What more or fewer looks at a cloud cost and bring.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_looks.py [--categories laptop eyeglasses] [--json]

Standard noisy views of unseen procedural objects; the same views for every row. ``1+3`` is the default: one random
choice of points for the first look, three for the second. Time is the least of network and fit in a batch.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import tyro

from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_views
from omad.estimation.estimator import Estimator, EstimatorConfig
from omad.evaluation.evaluate import evaluate

LOOKS = ((1,), (2,), (4,), (1, 1), (1, 2), (1, 3), (1, 5), (1, 8), (2, 6))


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    categories: tuple[str, ...] = ("laptop", "eyeglasses")
    objects: int = 40
    views: int = 400
    json: bool = False


def main(config: Config) -> None:
    answer = {}
    for name in config.categories:
        first = Estimator.from_pretrained(name, device="cpu")
        category = first.category
        models = [generate(category, index, "test") for index in range(config.objects)]
        views = list(standard_views(models, category, config.views))
        per_unit = np.where(category.turning, 180 / np.pi, 1 / category.metres_per_unit)
        rows = {}
        for looks in LOOKS:
            estimator = Estimator(first.net, EstimatorConfig(samples=looks))
            results = evaluate(estimator, views)
            off = np.array([np.mean(r.refined.joint_state * per_unit) for r in results])
            took = [sum(r.estimate.seconds.values()) for r in results if r.estimate]
            rows["+".join(map(str, looks))] = {
                "mean_state_error": float(off.mean()),
                "median_state_error": float(np.median(off)),
                "mean_axis_error_deg": float(np.degrees(np.mean([r.refined.axis.mean() for r in results]))),
                "ms": 1e3 * min(took),
            }
        answer[name] = rows
    if config.json:
        print(json.dumps(answer))
        return
    for name, rows in answer.items():
        print(f"{name}: joint state error, mean and median (degrees or units), axis error (degrees), ms an image")
        for looks, row in rows.items():
            print(f"  {looks:>4}  " + "  ".join(f"{value:8.3f}" for value in row.values()))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
