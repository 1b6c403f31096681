"""Fitting a template's surface to a cloud.

    sum over cloud and visible surface of rho(point - nearest point of the other)
    + (x - x0)^T C^-1 (x - x0)      x: pose, joint states, beta; C as the fit to the keypoints left it, widened
    + e^T E^-1 e                    e: what of the keypoints beta cannot say

Nearest points of a flat side are not the same points of it, so that what they are apart counts along the surface's
normal (Chen and Medioni, Object Modelling by Registration of Multiple Range Images, 1992); along the surface only what
is more than the points' spacing, as at its rim. E: each keypoint has its own, and those of a part that turns share
more: where its hinge is, no view tells well, and the angle should not pay for it.

A surface point is a weighted sum of keypoints and a fixed offset (``template``). Its derivative is taken to be that of
the keypoints: that offsets turn with their part is left out, with which answers are as good. Gauss-Newton: the pairs of
nearest points are found anew in each step. One object, camera frame, category units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.linalg import block_diag
from scipy.spatial import KDTree

from omad.common.arrays import as_doubles

from ..fitting.energy import keypoint_jacobian
from ..fitting.state import State
from ..prior import OmadPrior
from .placed import Floats, Placed, VisibleSurface
from .template import Template


@dataclass(frozen=True)
class FitConfig:
    """How a surface is fitted; lengths in category units."""

    steps: int = 8
    noise: float = 0.01
    """Of a point, and of how far a template is from the true surface."""
    cloud: float = 60.0
    """As how many independent measurements all pairs of cloud and surface count."""
    surface: float = 30.0
    """The same of the pairs of visible surface and cloud."""
    spacing: float = 0.03
    """Between points: along the surface only what pairs are farther apart counts."""
    robust: float = 0.06
    """Pairs farther apart hardly count."""
    widened: float = 1.5
    """By how much the standard deviations of the fit to the keypoints are widened."""
    own: float = 0.02
    """Standard deviation of ``e``, of each keypoint."""
    shared: float = 0.03
    """Of what the keypoints of a part that turns have of it in common."""
    limit_sigma: float = 0.02
    """Of joint states beyond their limits."""
    pixels: int = 96
    """Across the picture that says what is visible."""
    most: int = 800
    """Points of either kind that are paired."""


@dataclass(frozen=True)
class Cloud:
    """What was seen of the object."""

    points: Floats
    """(N, 3)."""
    labels: np.ndarray
    """(N,) part of each."""
    tree: KDTree
    """Of the points."""

    @classmethod
    def of(cls, points: np.ndarray, labels: np.ndarray, most: int) -> Cloud | None:
        """At most so many of points (N, 3), those with a part in ``labels`` (N,); None where none has."""
        inside = np.random.default_rng(0).permutation(np.flatnonzero(labels >= 0))[:most]
        if not len(inside):
            return None
        kept = points[inside].astype(np.float64)
        return cls(kept, labels[inside], KDTree(kept))


@dataclass(frozen=True)
class Pairs:
    """Points of the cloud and of the visible surface that are nearest to each other."""

    points: np.ndarray
    """(P,) of the cloud."""
    surface: np.ndarray
    """(P,) of the visible surface."""
    measurements: float
    """As how many independent ones they count."""

    def precision(self, off: Floats, noise: float, robust: float) -> Floats:
        """(P,) by which squared residuals ``off`` (P, 3) count: Geman-McClure's weights."""
        share = self.measurements / (len(off) * noise**2)
        return share / np.square(1 + np.square(off).sum(1) / robust**2)


@dataclass(frozen=True)
class SurfaceFit:
    """Fits templates to one cloud."""

    prior: OmadPrior
    """In float64."""
    limits: Floats
    """(J, 2) of joint states."""
    start: State
    """A batch of one, float64: what was found before."""
    precision: Floats
    """(P + 3 M, P + 3 M) of it and of ``e``."""
    cloud: Cloud
    config: FitConfig = FitConfig()

    @classmethod
    def of(
        cls, prior: OmadPrior, limits: Floats, start: State, covariance: Floats, cloud: Cloud, config: FitConfig
    ) -> SurfaceFit:
        """``covariance`` (P, P) of the unknowns, in ``state``'s order."""
        widened = covariance * config.widened**2 + 1e-10 * np.eye(len(covariance))
        own = np.linalg.inv(_own_covariance(prior, config))
        precision = block_diag(np.linalg.pinv(widened, hermitian=True), own)
        return cls(prior, limits, start, np.asarray(precision, np.float64), cloud, config)

    def begin(self) -> Placed:
        """What was found before."""
        own = np.zeros((self.prior.num_keypoints, 3))
        return Placed.at(self.prior, self.start, np.zeros(len(self.precision) - own.size), own)

    def visible(self, placed: Placed, template: Template) -> VisibleSurface:
        """What of a placed template the camera sees."""
        return VisibleSurface.of(placed, template, self.cloud.points, self.config.pixels, self.config.noise)

    def apart(self, placed: Placed, template: Template) -> float:
        """Mean distance of cloud from visible surface plus that of visible surface from cloud; far points count as
        ten times the noise."""
        seen, far = self.visible(placed, template), 10 * self.config.noise
        if not len(seen.points):
            return 2 * far
        both = KDTree(seen.points).query(self.cloud.points)[0], self.cloud.tree.query(seen.points)[0]
        return float(sum(np.minimum(each, far).mean() for each in both))

    def __call__(self, placed: Placed, template: Template) -> Placed:
        """The template where it fits best, from where it is ``placed``."""
        for _ in range(self.config.steps):
            placed = self._step(placed, template)
        return placed

    def _step(self, placed: Placed, template: Template) -> Placed:
        by_unknowns = as_doubles(keypoint_jacobian(self.prior, placed.state)[1])[0]
        H = self.precision.copy()
        g = -self.precision @ np.concatenate([placed.moved, placed.own.ravel()])
        states = 6 + np.arange(len(self.limits))
        theta = placed.state.joint_states[0].numpy()
        beyond = theta - theta.clip(*self.limits.T)
        H[states, states] += (beyond != 0) / self.config.limit_sigma**2
        g[states] -= beyond / self.config.limit_sigma**2
        seen = self.visible(placed, template)
        for pairs in self.pairs(seen):
            jacobian, off = self._residuals(pairs, placed, template, seen, by_unknowns)
            H += jacobian.T @ jacobian
            g += jacobian.T @ off
        step = np.linalg.solve(H + 1e-9 * np.diag(H.diagonal()), g)
        unknowns = len(placed.moved)
        moved, e = placed.moved + step[:unknowns], placed.own + step[unknowns:].reshape(-1, 3)
        return Placed.at(self.prior, self.start.moved(torch.as_tensor(moved)[None]), moved, e)

    def pairs(self, seen: VisibleSurface) -> list[Pairs]:
        """Points of the cloud with the nearest ones of their own part; of the visible surface with any."""
        cloud, config, of_cloud, of_surface = self.cloud, self.config, [], []
        for part in np.unique(seen.parts):
            points, surface = np.flatnonzero(cloud.labels == part), np.flatnonzero(seen.parts == part)
            if len(points):
                of_cloud.append(points)
                of_surface.append(surface[KDTree(seen.points[surface]).query(cloud.points[points])[1]])
        if not of_cloud:
            return []
        some = np.arange(0, len(seen.points), -(-len(seen.points) // config.most))
        forth = Pairs(np.concatenate(of_cloud), np.concatenate(of_surface), config.cloud)
        return [forth, Pairs(cloud.tree.query(seen.points[some])[1], some, config.surface)]

    def _residuals(
        self, pairs: Pairs, placed: Placed, template: Template, seen: VisibleSurface, by_unknowns: Floats
    ) -> tuple[Floats, Floats]:
        """Weighted derivatives (3 n, P + 3 M) of the surface points, and how far off they are (3 n,)."""
        config, count = self.config, len(pairs.points)
        off = self.cloud.points[pairs.points] - seen.points[pairs.surface]
        unknowns, parts, normals = by_unknowns.shape[2], seen.parts[pairs.surface], seen.normals[pairs.surface]
        along = normals[:, :, None] * normals[:, None]
        across = off - (along @ off[:, :, None])[:, :, 0]
        beyond = 1 - np.minimum(config.spacing / np.linalg.norm(across, axis=1).clip(1e-12), 1)
        root = np.sqrt(pairs.precision(off, config.noise, config.robust))[:, None, None]
        root = root * np.where(beyond[:, None, None] > 0, np.eye(3), along)
        off = off - (1 - beyond)[:, None] * across
        jacobian = np.zeros((count, 3, unknowns + placed.own.size))
        for number, part in enumerate(template.parts):
            rows = np.flatnonzero(parts == number)
            weights = part.samples.weights[seen.which[pairs.surface[rows]]]
            jacobian[rows, :, :unknowns] = root[rows] @ np.tensordot(weights, by_unknowns[part.keypoints], 1)
            turned = root[rows] @ placed.pose.T_camera_part[number, :3, :3]
            by_own = turned[:, :, None] * weights[:, None, :, None]
            columns = slice(unknowns + 3 * part.keypoints.start, unknowns + 3 * part.keypoints.stop)
            jacobian[rows, :, columns] = by_own.reshape(len(rows), 3, placed.own[part.keypoints].size)
        return jacobian.reshape(3 * count, -1), (root @ off[:, :, None]).ravel()


def _own_covariance(prior: OmadPrior, config: FitConfig) -> np.ndarray:
    """(3 M, 3 M) of ``e``."""
    shared = np.zeros((prior.num_keypoints,) * 2)
    for keypoints, turns in zip(prior.keypoints_of_part[1:], prior.tree.turning, strict=True):
        shared[keypoints, keypoints] = turns * config.shared**2
    return np.kron(shared + config.own**2 * np.eye(len(shared)), np.eye(3))
