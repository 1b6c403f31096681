"""Kalman filter over base pose and joint states: they keep their velocities, which change at random. Joints that
come to their limits stop there.

The state is (rotation vector of the base in camera axes, its translation, joint states) and its velocity, N = 6 + J
numbers each, in radians and metres; the rotation lives on SO(3) and the filter on its tangent, as the least squares do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from omad.estimation.estimate import Estimate
from omad.geometry.rigid import rigid

SUREST = 1e-4
"""Standard deviation, in radians and metres, that every number of a measurement has at least: a base that stands still
on a known vertical has directions in which neither moves, and distances from what cannot be are infinite."""


@dataclass(frozen=True)
class MotionConfig:
    """Process noise: roots of the spectral densities of the accelerations."""

    rotation: float = 0.5
    """Of the base before the camera, rad / s^1.5: how much its angular velocity changes in one second."""
    translation: float = 0.3
    """m / s^1.5."""
    turning: float = 2.0
    """Of joints, rad / s^1.5."""
    sliding: float = 0.6
    """Of joints, m / s^1.5."""
    decay: float = 1.0
    """Seconds in which a velocity that is not seen dies down, so that an unseen object comes to rest."""
    static_base: bool = False
    """The base stands still before the camera: only joints move."""


@dataclass(frozen=True)
class Placement:
    """Where the base is and how far the joints are open."""

    T_camera_base: np.ndarray
    """(4, 4)."""
    joint_states: np.ndarray
    """(J,)."""

    @classmethod
    def of(cls, estimate: Estimate) -> Placement:
        return cls(estimate.T_camera_base, estimate.joint_states)

    def moved(self, step: np.ndarray) -> Placement:
        """By a tangent step (N,)."""
        rotation = Rotation.from_rotvec(step[:3]).as_matrix() @ self.T_camera_base[:3, :3]
        return Placement(rigid(rotation, self.T_camera_base[:3, 3] + step[3:6]), self.joint_states + step[6:])

    def step_to(self, other: Placement) -> np.ndarray:
        """The step (N,) with ``self.moved(step) == other``."""
        turn = other.T_camera_base[:3, :3] @ self.T_camera_base[:3, :3].T
        shift = other.T_camera_base[:3, 3] - self.T_camera_base[:3, 3]
        return np.concatenate([Rotation.from_matrix(turn).as_rotvec(), shift, other.joint_states - self.joint_states])


class MotionFilter:
    """Starts at rest at a placement measured with ``covariance`` (N, N); joints move within ``limits`` (J, 2), radians
    or metres."""

    def __init__(
        self,
        config: MotionConfig,
        turning: tuple[bool, ...],
        start: Placement,
        covariance: np.ndarray,
        limits: ArrayLike = (-np.inf, np.inf),
    ) -> None:
        self.config, self.placement = config, start
        self._low, self._high = np.asarray(limits, dtype=np.float64).T
        joints = [config.turning if turns else config.sliding for turns in turning]
        base = [0.0] * 6 if config.static_base else [config.rotation] * 3 + [config.translation] * 3
        self._density = np.diag(np.square(base + joints))
        self._size = len(covariance)
        self.velocity = np.zeros(self._size)
        rest = np.zeros_like(covariance)
        self._covariance = np.block([[covariance, rest], [rest, self._density * config.decay]])

    @property
    def covariance(self) -> np.ndarray:
        """(N, N) of the placement."""
        return self._covariance[: self._size, : self._size]

    def predict(self, dt: float) -> None:
        """Move on by ``dt`` seconds."""
        kept = np.exp(-dt / self.config.decay)
        reach = self.config.decay * (1 - kept)  # of a velocity that dies down
        before, moved = self.placement.joint_states, self.placement.moved(reach * self.velocity)
        # what was measured beyond a limit may stay there
        states = moved.joint_states.clip(np.minimum(self._low, before), np.maximum(self._high, before))
        self.velocity = kept * self.velocity
        self.velocity[6:][states != moved.joint_states] = 0.0
        self.placement = replace(moved, joint_states=states)
        F = np.kron([[1, reach], [0, kept]], np.eye(self._size))
        Q = np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], self._density)
        self._covariance = F @ self._covariance @ F.T + Q

    def surprise(self, measured: Placement, covariance: np.ndarray) -> float:
        """Squared Mahalanobis distance of a measurement from what was predicted: chi-square with N degrees."""
        step = self.placement.step_to(measured)
        return float(step @ np.linalg.solve(self.covariance + self._noise(covariance), step))

    def update(self, measured: Placement, covariance: np.ndarray) -> None:
        """Take in a placement measured with ``covariance`` (N, N)."""
        n, noise = self._size, self._noise(covariance)
        gain = np.linalg.solve(self.covariance + noise, self._covariance[:n]).T
        correction = gain @ self.placement.step_to(measured)
        self.placement = self.placement.moved(correction[:n])
        self.velocity = self.velocity + correction[n:]
        remaining = np.eye(2 * n)
        remaining[:, :n] -= gain
        # Joseph's form stays symmetric and positive whatever the rounding
        self._covariance = remaining @ self._covariance @ remaining.T + gain @ noise @ gain.T

    def _noise(self, covariance: np.ndarray) -> np.ndarray:
        return covariance + SUREST**2 * np.eye(self._size)
