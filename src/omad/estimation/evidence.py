"""How well an estimate explains what was seen: numbers that mean the same for every category.

Lengths are relative to the size of the cloud, expected errors to the category's unit; 0 or strongly negative is good.
"""

from dataclasses import astuple, dataclass

import numpy as np

from omad.common.arrays import as_doubles
from omad.data.rendering.rasteriser import render
from omad.geometry.camera import Camera
from omad.geometry.rigid import diagonal
from omad.model.prior import OmadPrior
from omad.model.surfaces.agreement import NOWHERE, Agreement
from omad.sensing.observation import Observation

from .estimate import Estimate
from .nearest import nearest

PIXELS = 96
"""Across the picture in which model and cloud are compared."""
SURE = 1e-3
"""Of a keypoint's misfit: below it nothing fits better."""
FAR = 0.2
"""A point this far from a surface, as a share of the object's size, is as wrong as one farther away."""
MAX_POINTS = 4000
"""Of the cloud that are compared."""


@dataclass(frozen=True)
class Evidence:
    """What speaks against an estimate; each number grows as it fits worse."""

    misfit: float
    """Log of the mean squared distance between model and seen keypoints in their standard deviations."""
    unsure: float
    """Log of the error that the network expects of its keypoints, category units."""
    shape_mahalanobis: float
    """Squared distance of beta from the category's mean in standard deviations, per number of beta."""
    uncovered: float
    """Mean distance of the seen points from the model's visible surface."""
    unseen: float
    """Mean distance of the model's visible surface from the seen points."""

    @property
    def values(self) -> np.ndarray:
        """(5,) all of them, in this order."""
        return np.array(astuple(self))


def measure_evidence(observation: Observation, estimate: Estimate, prior: OmadPrior) -> Evidence:
    """Compare an estimate with its observation and with the objects that its network was trained on."""
    points = observation.points[:: -(-len(observation.points) // MAX_POINTS)].astype(np.float64)
    size = diagonal(points)
    surface = _visible(estimate, points)
    off = np.square((estimate.keypoints - estimate.observed_keypoints) / estimate.keypoint_std[:, None])
    unusual = estimate.beta - as_doubles(prior.beta_mean)
    precision = np.linalg.pinv(as_doubles(prior.beta_covariance), hermitian=True)
    return Evidence(
        misfit=float(np.log(off.mean() + SURE)),
        unsure=float(np.log(estimate.keypoint_std / estimate.category.metres_per_unit).mean()),
        shape_mahalanobis=float(unusual @ precision @ unusual / len(unusual)),
        uncovered=_apart(points, surface, size),
        unseen=_apart(surface, points, size),
    )


def explanation(observation: Observation, estimate: Estimate) -> Agreement:
    """What of the observation the estimate's surface explains, as keypoints alone tell it."""
    if not estimate.is_finite:
        return NOWHERE
    return Agreement.of(estimate.carried_model().posed(estimate.joint_states, estimate.T_camera_base), observation)


def _visible(estimate: Estimate, points: np.ndarray) -> np.ndarray:
    """(N, 3) points of the estimated object's visible surface, in the camera frame."""
    around = np.concatenate([points, estimate.keypoints])
    around = around[around[:, 2] > 0]
    if not estimate.is_finite or not len(around):  # where a network is shown what is far beyond its size
        return np.zeros((0, 3))
    camera = Camera.around(around[:, :2] / around[:, 2:], PIXELS)
    depth = render(estimate.hull_model(), estimate.joint_states, estimate.T_camera_base, camera).depth
    rows, columns = np.nonzero(depth)
    return camera.backproject(np.stack([columns, rows], 1), depth[rows, columns].astype(np.float64))


def _apart(points: np.ndarray, others: np.ndarray, size: float) -> float:
    """Mean distance of points (N, 3) from the nearest of the others, as a share of ``size``, ``FAR`` at most."""
    if not len(points) or not len(others):
        return FAR
    nearby = others[nearest(points.astype(np.float32), others.astype(np.float32))]
    return float(np.minimum(np.linalg.norm(points - nearby, axis=1) / max(size, 1e-9), FAR).mean())
