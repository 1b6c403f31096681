"""How alike the errors of views of one object are, which tells what further views of it are worth."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import views_together
from omad.estimation.estimator import Estimator
from omad.estimation.several_views import alike_by_angle
from omad.objects.model import ObjectModel

from .gathered import Begun, Rows, gathered
from .views import APART

VIEWS = 3
"""Of each object."""
MOST = 3.0
"""Standard deviations that an error counts as at most: views seen the wrong way round should not decide."""
BATCH = 20
DIGITS = 3
"""Behind the point; more are chance."""


def fit_shared(
    estimator: Estimator, models: Sequence[ObjectModel], objects: int, seed: int, begun: Begun | None = None
) -> float:
    """``Confidence.shared`` from so many of the ``models``, each seen from several sides at one moment. With ``begun``
    it goes on."""
    category = estimator.category

    def made(indices: range) -> Rows:
        some = [(models[index % len(models)], (seed, index, APART)) for index in indices]
        views = [view for model, each in some for view in views_together(model, category, each, VIEWS, ON)]
        estimates = estimator([view.observation() for view in views])
        std = np.array([[joint.state_std for joint in estimate.joints] for estimate in estimates])
        off = np.array([estimate.joint_states for estimate in estimates]) - [view.states for view in views]
        directions = np.array([np.linalg.inv(view.T_camera_base)[:3, 3] for view in views])
        rows = {"errors": np.clip(off / std, -MOST, MOST), "directions": directions}
        return {name: each.reshape(len(some), VIEWS, -1) for name, each in rows.items()}

    rows = gathered(made, objects, BATCH, f"shared-{seed}", begun)
    return round(shared_part(**rows), DIGITS)


def shared_part(errors: np.ndarray, directions: np.ndarray) -> float:
    """From 0 to 1, what of the errors (N, V, J) of N objects' views from ``directions`` (N, V, 3) is of the object, as
    their products and squares say when they are added up over all pairs of its views."""
    unit = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    more = all_of = 0.0
    for a, b in combinations(range(errors.shape[1]), 2):
        near = alike_by_angle(np.arccos(np.clip((unit[:, a] * unit[:, b]).sum(-1), -1, 1)))
        product = (errors[:, a] * errors[:, b]).mean(-1)
        square = 0.5 * (np.square(errors[:, a]) + np.square(errors[:, b])).mean(-1)
        more += float((product - near * square).sum())
        all_of += float(((1 - near) * square).sum())
    return float(np.clip(more / max(all_of, 1e-12), 0.0, 1.0))
