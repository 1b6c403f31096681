"""The demo: unseen procedural objects, one depth image each, estimate against truth, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .estimator import Estimator
from .evaluation import true_pose
from .html_report import save_html
from .metrics import pose_errors
from .observation import Observation
from .report import figure, save
from .sources.procedural import generate
from .standard_views import standard_view


def run_demo(estimators: Sequence[Estimator], output: Path, objects: int, seed: int) -> dict[str, Any]:
    """Estimate ``objects`` unseen objects of each category and draw them; returns the promised JSON."""
    results, files = [], []
    for estimator in estimators:
        category = estimator.category
        for index in range(objects):
            model = generate(category, index, "test", seed)
            view = standard_view(model, category, (seed, 1000 + index))
            observation = Observation.from_depth(view.depth, view.camera)
            estimate = estimator(observation)
            truth = true_pose(view, category)
            errors = pose_errors(estimate.pose(), truth, view.truth.part_boxes, category)
            folder = output / model.name
            estimate.save_urdf(folder / "object.urdf")
            save(figure(observation, estimate, truth, model.name), folder / "estimate.png")
            save_html(observation, estimate, folder / "estimate.html", truth, model.name)
            names = ["estimate.png", "estimate.html", "object.urdf", "state.json"]
            files += [str(folder / name) for name in names]
            results.append(
                {
                    "category": category.name,
                    "object": model.name,
                    "estimate": estimate.to_dict(),
                    "truth": {
                        "joint_states": view.states.tolist(),
                        "T_camera_base": view.T_camera_base.tolist(),
                        "axes": truth.axes.tolist(),
                        "pivots": [
                            p.tolist() if r else None for p, r in zip(truth.pivots, category.revolute, strict=True)
                        ],
                    },
                    "errors": {
                        "joint_state": errors.joint_state.tolist(),
                        "axis_deg": np.degrees(errors.axis).tolist(),
                        "axis_distance": [None if np.isnan(d) else d for d in errors.axis_distance.tolist()],
                        "rotation_deg": np.degrees(errors.rotation).tolist(),
                        "translation": errors.translation.tolist(),
                    },
                }
            )
    return {"results": results, "files": files}
