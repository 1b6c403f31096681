"""What the explorer draws: from shape parameters and joint states to geometry. Pure; it knows nothing of the page.

Everything is in the canonical base frame (y up, z to the front), in metres and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ..categories import Category
from ..estimate import Estimate, convex_hull
from ..kinematics import deform, joint_lines, part_transforms
from ..objects import Mesh
from ..prior import OmadPrior

SIGMAS = 3.0
"""How far a shape slider goes to either side."""


@dataclass(frozen=True)
class ObjectState:
    """One object of the category: what all sliders say together."""

    beta: np.ndarray
    """(D,) shape parameters."""
    joint_states: np.ndarray
    """(J,) radians or metres."""

    def with_joint(self, joint: int, state: float) -> ObjectState:
        """The same object with one joint moved."""
        return replace(self, joint_states=_changed(self.joint_states, joint, state))


@dataclass(frozen=True)
class JointRange:
    """A joint's slider, in the units in which a person reads it."""

    name: str
    unit: str
    """° or cm."""
    per_unit: float
    """Radians or metres of one of these."""
    low: float
    high: float


@dataclass(frozen=True)
class Drawing:
    """Geometry of an object."""

    keypoints: np.ndarray
    """(M, 3)."""
    hulls: tuple[Mesh, ...]
    """Per part the convex hull of its keypoints, at rest."""
    T_base_part: np.ndarray
    """(K, 4, 4) takes rest coordinates of a part to where it is."""
    arrows: np.ndarray
    """(J, 2, 3) tail and head of each joint's axis."""


class ObjectSpace:
    """All objects that a category's prior knows."""

    def __init__(self, prior: OmadPrior, category: Category) -> None:
        self.category = category
        self._prior = prior
        self._mean = prior.beta_mean.detach().cpu().double().numpy()
        self._covariance = prior.beta_covariance.detach().cpu().double().numpy()
        self._sigma = np.maximum(np.sqrt(np.clip(np.diag(self._covariance), 0, None)), 1e-9)
        unit = category.metres_per_unit
        scale = [1.0 if revolute else unit for revolute in category.revolute]
        self.limits = np.array([joint.limits for joint in category.joints]) * np.array(scale)[:, None]
        """(J, 2) radians or metres."""

    @property
    def components(self) -> int:
        """Numbers that beta has."""
        return len(self._mean)

    @property
    def joint_ranges(self) -> tuple[JointRange, ...]:
        """A slider for each joint."""
        ranges = []
        for joint, (low, high) in zip(self.category.joints, self.limits, strict=True):
            unit, per_unit = ("°", math.radians(1)) if joint.type == "revolute" else ("cm", 0.01)
            ranges.append(JointRange(joint.name, unit, per_unit, float(low / per_unit), float(high / per_unit)))
        return tuple(ranges)

    def mean(self) -> ObjectState:
        """The mean shape, every joint at rest (or as near to it as its limits let it)."""
        return ObjectState(self._mean.copy(), np.clip(0.0, self.limits[:, 0], self.limits[:, 1]))

    def random(self, rng: np.random.Generator) -> ObjectState:
        """A shape from the prior's normal distribution, joint states uniform within limits."""
        beta = rng.multivariate_normal(self._mean, self._covariance, method="eigh")
        return ObjectState(beta, rng.uniform(self.limits[:, 0], self.limits[:, 1]))

    def estimated(self, estimate: Estimate) -> ObjectState:
        """The object that was found."""
        return ObjectState(estimate.beta.copy(), estimate.joint_states)

    def sigmas(self, state: ObjectState) -> np.ndarray:
        """(D,) how many standard deviations each number of beta is away from its mean."""
        return (state.beta - self._mean) / self._sigma

    def with_sigma(self, state: ObjectState, component: int, sigmas: float) -> ObjectState:
        """The same joints with one number of beta changed."""
        value = self._mean[component] + sigmas * self._sigma[component]
        return replace(state, beta=_changed(state.beta, component, float(value)))

    @torch.no_grad()
    def draw(self, state: ObjectState) -> Drawing:
        """Keypoints, part hulls and joint axes of an object."""
        prior, unit = self._prior, self.category.metres_per_unit
        like = prior.learned_basis
        beta = torch.as_tensor(state.beta).to(like)[None]
        joints, rest = prior.joints(beta), prior.keypoints(beta)
        scale = np.where(self.category.revolute, 1.0, unit)
        states = torch.as_tensor(state.joint_states / scale).to(like)[None]
        origin = torch.eye(4).to(like)[None]
        G = part_transforms(prior.tree, joints.axes, joints.pivots, states, origin)
        lines = joint_lines(prior.tree, joints.axes, joints.pivots, G)
        keypoints = _numpy(deform(prior.tree, prior.part_of, rest, joints.axes, joints.pivots, states, origin))
        placed = _numpy(G)
        placed[:, :3, 3] *= unit
        return Drawing(
            keypoints=keypoints * unit,
            hulls=tuple(convex_hull(_numpy(rest)[part] * unit) for part in prior.keypoints_of_part),
            T_base_part=placed,
            arrows=self._arrows(keypoints, _numpy(lines.axes), _numpy(lines.pivots)) * unit,
        )

    def _arrows(self, keypoints: np.ndarray, axes: np.ndarray, pivots: np.ndarray) -> np.ndarray:
        """An axis passes the part that it moves, and sticks out of it on either side."""
        arrows = []
        for part, (axis, pivot) in enumerate(zip(axes, pivots, strict=True), start=1):
            moved = keypoints[self._prior.keypoints_of_part[part]]
            revolute = self.category.revolute[part - 1]
            foot = pivot + axis * (axis @ (moved.mean(0) - pivot)) if revolute else moved.mean(0)
            half = max(0.6 * float(np.ptp(moved @ axis)), 0.3)
            arrows.append([foot - half * axis, foot + half * axis])
        return np.array(arrows)


def _changed(values: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[index] = value
    return changed


def _numpy(batch_of_one: Tensor) -> np.ndarray:
    return batch_of_one[0].cpu().double().numpy()
