"""What the explorer draws: from shape parameters and joint states to geometry. Pure; it knows nothing of the page.

Everything is in the canonical base frame (y up, z to the front), in metres and radians.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch

from omad.common.arrays import as_doubles
from omad.data.rendering.viewpoints import random_states
from omad.estimation.estimate import Estimate
from omad.geometry.mesh import Mesh, convex_hull
from omad.model.fitting.posed_object import PosedObject, posed_objects
from omad.model.fitting.state import State
from omad.model.prior import OmadPrior
from omad.model.surfaces.surfaces import Surfaces
from omad.objects.category import Category
from omad.output.picture import reading

SIGMAS = 3.0
"""How far a shape slider goes to either side."""


@dataclass(frozen=True)
class ObjectState:
    """One object of the category: what all sliders say together."""

    beta: np.ndarray
    """(D,) shape parameters."""
    joint_states: np.ndarray
    """(J,) radians or metres."""
    of_other_hand: bool = False
    """It is the mirror image of what beta says."""


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
    parts: tuple[Mesh, ...]
    """Each part's surface at rest."""
    T_base_part: np.ndarray
    """(K, 4, 4) takes rest coordinates of a part to where it is."""
    arrows: np.ndarray
    """(J, 2, 3) tail and head of each joint's axis."""


class ObjectSpace:
    """All objects that a category's prior knows."""

    def __init__(self, prior: OmadPrior, category: Category, surfaces: Surfaces | None = None) -> None:
        """Without ``surfaces`` parts are drawn as hulls of their keypoints."""
        self.category, self._prior, self._surfaces = category, prior, surfaces
        self._mean, self._covariance = as_doubles(prior.beta_mean), as_doubles(prior.beta_covariance)
        self._sigma = np.maximum(np.sqrt(np.clip(np.diag(self._covariance), 0, None)), 1e-9)
        self.limits = category.metric_limits
        """(J, 2) radians or metres."""

    @property
    def components(self) -> int:
        """Numbers that beta has."""
        return len(self._mean)

    @property
    def joint_ranges(self) -> tuple[JointRange, ...]:
        """A slider for each joint."""
        ranges = []
        for joint, limits in zip(self.category.joints, self.limits, strict=True):
            per_unit, unit = reading(joint.motion.turns)
            ranges.append(JointRange(joint.name, unit.strip(), per_unit, *(limits / per_unit).tolist()))
        return tuple(ranges)

    def mean(self) -> ObjectState:
        """The mean shape, every joint at rest (or as near to it as its limits let it)."""
        return ObjectState(self._mean.copy(), np.clip(0.0, *self.limits.T))

    def random(self, rng: np.random.Generator) -> ObjectState:
        """A shape from the prior's normal distribution, possible joint states within limits."""
        beta = rng.multivariate_normal(self._mean, self._covariance, method="eigh")
        return ObjectState(beta, random_states(self.limits, self.category.joints, rng))

    def estimated(self, estimate: Estimate) -> ObjectState:
        """The object that was found."""
        return ObjectState(estimate.beta.copy(), estimate.joint_states, estimate.of_other_hand)

    def sigmas(self, state: ObjectState) -> np.ndarray:
        """(D,) how many standard deviations each number of beta is away from its mean."""
        return (state.beta - self._mean) / self._sigma

    def with_sigma(self, state: ObjectState, component: int, sigmas: float) -> ObjectState:
        """The same joints with one number of beta changed."""
        value = float(self._mean[component] + sigmas * self._sigma[component])
        return replace(state, beta=_changed(state.beta, component, value))

    def with_joint(self, state: ObjectState, joint: int, value: float) -> ObjectState:
        """The same object with one joint moved, no farther than another one lets it; what that one is for is taken
        along."""
        states, specs = _changed(state.joint_states, joint, value), self.category.joints
        held = {joint}
        for index, spec in enumerate(specs):  # a joint stands after the one that holds it
            if spec.at_most is not None and held & {index, spec.at_most}:
                top = states[spec.at_most].clip(*self.limits[index])
                if states[index] > top:
                    states[index], held = top, held | {index}
        return replace(state, joint_states=states)

    def draw(self, state: ObjectState) -> Drawing:
        """Keypoints, parts and joint axes of an object."""
        values = (state.beta, state.joint_states / self.category.state_units, np.eye(4))
        like = self._prior.learned_basis
        [posed] = posed_objects(self._prior, self.category, State(*(torch.as_tensor(v).to(like)[None] for v in values)))
        if self._surfaces is not None:
            parts = self._surfaces.of_keypoints(posed.canonical_keypoints)
        else:
            parts = tuple(convex_hull(posed.canonical_keypoints[part]) for part in self._prior.keypoints_of_part)
        if state.of_other_hand:
            posed, parts = posed.reflected(self.category.turning), tuple(part.mirrored() for part in parts)
        return Drawing(posed.keypoints, parts, posed.placed.T_camera_part, self._arrows(posed))

    def _arrows(self, posed: PosedObject) -> np.ndarray:
        """An axis passes the part that it moves, and sticks out of it on either side."""
        arrows, least, pose = [], 0.3 * self.category.metres_per_unit, posed.placed
        for joint, (axis, pivot, turns) in enumerate(zip(pose.axes, pose.pivots, self.category.turning, strict=True)):
            moved = posed.keypoints[self._prior.keypoints_of_part[joint + 1]]
            foot = pivot + axis * (axis @ (moved.mean(0) - pivot)) if turns else moved.mean(0)
            half = max(0.6 * float(np.ptp(moved @ axis)), least)
            arrows.append([foot - half * axis, foot + half * axis])
        return np.array(arrows)


def _changed(values: np.ndarray, index: int, value: float) -> np.ndarray:
    return np.where(np.arange(len(values)) == index, value, values)
