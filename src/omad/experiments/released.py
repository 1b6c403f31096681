"""Errors as the authors' released evaluation counts them, where that differs from ours.

- What is not a number is left out of the mean, instead of counting as the worst; a missing joint or part is.
- The distance of axes is that of skew lines whatever their angle: large errors shrink as axes become parallel.
- A part's translation error is that of its canonical origin, not of the middle of its box.
- Only one labelling is right, also of scissors.

Its IoU compares boxes in canonical space, which says nothing of the pose; that is not repeated here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..metrics import ObjectPose


@dataclass(frozen=True)
class ReleasedErrors:
    """Of V views; NaN where there is no number. Radians and metres."""

    joint_state: np.ndarray
    """(V, J)."""
    axis: np.ndarray
    """(V, J)."""
    axis_distance: np.ndarray
    """(V, J)."""
    rotation: np.ndarray
    """(V, K)."""
    translation: np.ndarray
    """(V, K)."""


def released_errors(found: tuple[ObjectPose, ...], true: tuple[ObjectPose, ...]) -> ReleasedErrors:
    """Errors of poses against the true ones."""
    a, b = _Columns.of(found), _Columns.of(true)
    across = np.cross(a.axes, b.axes)
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.abs((across * (a.pivots - b.pivots)).sum(-1)) / np.linalg.norm(across, axis=-1)
    cosine = (np.einsum("vkij,vkij->vk", a.T[..., :3, :3], b.T[..., :3, :3]) - 1) / 2
    return ReleasedErrors(
        joint_state=np.abs(a.states - b.states),
        axis=np.arccos(np.clip((a.axes * b.axes).sum(-1), -1, 1)),
        axis_distance=distance,
        rotation=np.arccos(np.clip(cosine, -1, 1)),
        translation=np.linalg.norm(a.T[..., :3, 3] - b.T[..., :3, 3], axis=-1),
    )


def known_means(errors: np.ndarray) -> list[float]:
    """Mean over views (V, N) of each column's numbers."""
    return [float(column[np.isfinite(column)].mean()) if np.isfinite(column).any() else np.nan for column in errors.T]


@dataclass(frozen=True)
class _Columns:
    states: np.ndarray
    axes: np.ndarray
    pivots: np.ndarray
    T: np.ndarray

    @classmethod
    def of(cls, poses: tuple[ObjectPose, ...]) -> _Columns:
        return cls(*(np.stack([getattr(p, n) for p in poses]) for n in ("states", "axes", "pivots", "T_camera_part")))
