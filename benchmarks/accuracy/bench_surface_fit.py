"""What the choices in the fit of surfaces bring: mean errors of joint states and bases, and distances of surfaces.

    OMP_NUM_THREADS=1 python benchmarks/accuracy/bench_surface_fit.py [--categories dishwasher] [--views 60]

Noisy views of as many unseen procedural objects, each fitted in every way, all of the way from the keypoints' answer.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import tyro

from omad.common.batches import progress
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import LEVELS
from omad.data.rendering.standard_views import standard_view, true_pose
from omad.estimation.estimator import Estimator
from omad.evaluation.metrics import pose_errors
from omad.evaluation.shape import surface_distances
from omad.geometry.mesh import merge_meshes
from omad.model.surfaces.fitting import FitConfig

HELD = 1e-4
WAYS = {
    "pairs in all directions, hinges held": {"spacing": 0.0, "shared": HELD},
    "along the normal alone, hinges held": {"spacing": np.inf, "shared": HELD},
    "along the normal alone": {"spacing": np.inf},
    "and beyond their spacing in all directions": {},
}


def main(categories: tuple[str, ...] = ("dishwasher", "refrigerator_two_doors"), views: int = 60) -> None:
    for name in categories:
        errors: dict[str, list[np.ndarray]] = {}
        estimator = Estimator.from_pretrained(name, device="cpu")
        category, surfaces = estimator.category, estimator.surfaces
        assert surfaces is not None
        per_unit = np.where(category.turning, 180 / np.pi, 1 / category.metres_per_unit)
        for index in progress(range(views), views):
            model = generate(category, index, "test")
            view = standard_view(model, category, (0, index), LEVELS["on"])
            estimate, truth = estimator(view.observation()), true_pose(view, category)
            whole = merge_meshes(model.posed(view.states, view.T_camera_base))
            if estimate.of_other_hand:
                continue
            off = pose_errors(estimate.pose(), truth, view.truth.part_boxes, category)
            row = np.array([*off.joint_state * per_unit, np.degrees(off.rotation[0]), np.nan])
            errors.setdefault("keypoints", []).append(row)
            for way, settings in WAYS.items():
                surfaces.config = replace(surfaces.config, fit=FitConfig(**settings))
                seen = estimate.labelled.points, estimate.part_labels
                fitted = surfaces.fitted(estimate, estimate.covariance, *seen)
                off = pose_errors(fitted.placed, truth, view.truth.part_boxes, category)
                far = np.mean([each.mean() for each in surface_distances(merge_meshes(fitted.posed()), whole)])
                far /= category.metres_per_unit
                row = np.array([*off.joint_state * per_unit, np.degrees(off.rotation[0]), far])
                errors.setdefault(way, []).append(row)
        print(f"{name}: joint states (degrees, or units), base (degrees), distance (units)")
        for way, rows in errors.items():
            print(f"  {way:44s}", np.mean(rows, 0).round(4))


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
