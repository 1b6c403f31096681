"""The demo: unseen procedural objects, one depth image each, estimate against truth, pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view, true_pose
from omad.estimation.estimator import Estimator
from omad.output.page import save_html
from omad.output.picture import figure, save

from .metrics import pose_errors


def run_demo(estimators: Sequence[Estimator], output: Path, objects: int, seed: int) -> dict[str, Any]:
    """Estimate ``objects`` unseen objects of each category and draw them; returns the promised JSON."""
    results, files = [], []
    for estimator in estimators:
        category = estimator.category
        for index in range(objects):
            model = generate(category, index, "test", seed)
            folder, name = output / model.name, model.name
            view = standard_view(model, category, (seed, 1000 + index))
            observation, truth = view.observation(), true_pose(view, category)
            estimate = estimator(observation)
            errors = pose_errors(estimate.pose(), truth, view.truth.part_boxes, category)
            estimate.save_urdf(folder / "object.urdf")
            save(figure(observation, estimate, truth, name), folder / "estimate.png")
            save_html(observation, estimate, folder / "estimate.html", truth, name)
            files += [str(folder / file) for file in ("estimate.png", "estimate.html", "object.urdf", "state.json")]
            pivots = [p.tolist() if turns else None for p, turns in zip(truth.pivots, category.turning, strict=True)]
            results.append(
                {
                    "category": category.name,
                    "object": name,
                    "estimate": estimate.to_dict(),
                    "truth": {
                        "joint_states": view.states.tolist(),
                        "T_camera_base": view.T_camera_base.tolist(),
                        "axes": truth.axes.tolist(),
                        "pivots": pivots,
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
