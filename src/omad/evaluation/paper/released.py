"""Errors as the authors' released evaluation counts them, where that differs from ours.

- What is not a number is left out of the mean, instead of counting as the worst; a missing joint or part is.
- The distance of axes is that of skew lines whatever their angle: large errors shrink as axes become parallel.
- A part's translation error is that of its canonical origin, not of the middle of its box.
- Only one labelling is right, also of scissors.

Its IoU compares boxes in canonical space, which says nothing of the pose; that is not repeated here.
"""

import numpy as np

from omad.objects.category import Category
from omad.objects.pose import ObjectPose


def released_errors(a: ObjectPose, b: ObjectPose, category: Category) -> dict[str, np.ndarray]:
    """Errors (V, J) or (V, K) of the poses ``a`` of V objects against the true ones, ``b``: degrees and category units,
    NaN where there is no number."""
    unit = category.metres_per_unit
    T, true = a.T_camera_part, b.T_camera_part
    across = np.cross(a.axes, b.axes)
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.abs((across * (a.pivots - b.pivots)).sum(-1)) / np.linalg.norm(across, axis=-1)
    cosine = (np.einsum("vkij,vkij->vk", T[..., :3, :3], true[..., :3, :3]) - 1) / 2
    state = np.abs(a.states - b.states)
    return {
        "joint_state": np.where(category.turning, np.degrees(state), state / unit),
        "axis_error_deg": np.degrees(np.arccos(np.clip((a.axes * b.axes).sum(-1), -1, 1))),
        "axis_distance": distance / unit,
        "rotation_error_deg": np.degrees(np.arccos(np.clip(cosine, -1, 1))),
        "translation_error": np.linalg.norm(T[..., :3, 3] - true[..., :3, 3], axis=-1) / unit,
    }


def known_means(errors: np.ndarray) -> list[float]:
    """Mean over views (V, N) of each column's numbers."""
    return [float(column[np.isfinite(column)].mean()) if np.isfinite(column).any() else np.nan for column in errors.T]
