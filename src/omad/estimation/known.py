"""What is known of an object before it is looked at: held fixed while the rest is estimated."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from omad.common.arrays import as_doubles, as_numpy, number, numbers
from omad.common.errors import InputError
from omad.geometry.rigid import mirrored, rigid
from omad.geometry.transforms import MIRROR_X, make_transform, so3_exp
from omad.model.fitting.refinement import free_directions
from omad.model.fitting.state import State
from omad.objects.category import Category
from omad.sensing.observation import Observation

from .joint_estimate import check_state

LARGEST = 1e4
"""Of what can be known: radians, metres, numbers of beta."""
LEAST = 1e-9
"""Length of a direction."""
ROLLED = np.radians(20)
"""By more than this a camera is not about level."""
HELD = 1e-9
"""Variance of a shape that was held fixed, for who needs the inverse of its covariance."""
SEEN_DOWN = 0.2
"""Share of gravity in the image, below which the camera looks up or down and has no roll."""


@dataclass(frozen=True, eq=False)
class Known:
    """Knowledge that holds for every observation of a call. Leave out what is not known."""

    beta: np.ndarray | None = None
    """(D,) shape parameters, of the same object estimated earlier, say."""
    joint_states: np.ndarray | None = None
    """(J,) radians or metres; NaN for a joint whose state is not known."""
    gravity: np.ndarray | None = None
    """(3,) direction in the camera frame, for an object that stands upright."""
    mirrored_probability: float | None = None
    """That the object is of the other hand, as ``Estimate.of_other_hand`` has it, where its category has either; what a
    view tells of that counts where it is surer."""

    @property
    def is_nothing(self) -> bool:
        """Whether all that the fit holds fixed is left out, or unknown."""
        if self.beta is not None or self.gravity is not None:
            return False
        return self.joint_states is None or bool(np.isnan(as_numpy(self.joint_states)).all())

    def mirrored(self) -> Self:
        """Of what is seen in a mirror in the camera's plane x = 0."""
        down, hand = self.gravity, self.mirrored_probability
        down = None if down is None else as_doubles(down) * MIRROR_X
        return replace(self, gravity=down, mirrored_probability=None if hand is None else 1 - hand)

    def of(self, category: Category) -> Self:
        """What of it may be said of a ``category``, where several are asked: those of one hand have no other."""
        return self if category.either_hand else replace(self, mirrored_probability=None)

    def seen_from(self, T_first_camera: np.ndarray) -> list[Self]:
        """What is known in the first camera's frame in those of cameras at ``T_first_camera`` (V, 4, 4). Raises
        InputError where gravity is no direction."""
        if self.gravity is None:
            return [self] * len(T_first_camera)
        return [replace(self, gravity=self.direction_of_gravity() @ T[:3, :3]) for T in T_first_camera]

    def direction_of_gravity(self) -> np.ndarray:
        """(3,) unit. Raises InputError where gravity is no direction."""
        down = numbers(self.gravity, 3, what="known gravity")
        length = np.linalg.norm(down)
        if not LEAST < length <= LARGEST:
            raise InputError(f"known gravity: a direction is needed, got a vector of length {length:.3g}")
        return down / length

    def levelling(self, like: Tensor, T_first_camera: Tensor | None = None) -> Tensor:
        """(B, 4, 4) what turns frames with the cameras' axes, to look in at B clouds, about the last of these until
        gravity points down, where a camera is ``ROLLED``: networks know objects as cameras see them that are about
        level. Of cameras at ``T_first_camera`` (B, 4, 4) gravity is known in the first one's frame; without, in each
        one's own. Dtype, device and B are those of ``like``."""
        if self.gravity is None:
            return torch.eye(4).to(like).expand(len(like), 4, 4)
        down = self.direction_of_gravity()
        seen = down[None] if T_first_camera is None else down @ as_doubles(T_first_camera)[:, :3, :3]
        x, y, _ = seen.T
        roll = np.arctan2(-x, y)
        roll[(np.hypot(x, y) < SEEN_DOWN) | (np.abs(roll) < ROLLED)] = 0.0
        turns = so3_exp(torch.as_tensor(roll[:, None] * (0.0, 0.0, 1.0)))
        return make_transform(turns, torch.zeros_like(turns[:, 0])).to(like).expand(len(like), 4, 4)

    def level_turn(self) -> np.ndarray:
        """(3, 3) that takes vectors from a level camera's frame to that of the one camera (``levelling``)."""
        return as_doubles(self.levelling(torch.eye(4, dtype=torch.float64)[None]))[0, :3, :3]

    def as_level(self, observation: Observation) -> Observation:
        """What a camera that is not rolled would see: the points alone are turned (``levelling``)."""
        if self.gravity is None:
            return observation
        return Observation.from_points(observation.points @ self.level_turn())

    def apply_to(self, start: State, category: Category) -> State:
        """``start`` (category units) with the known values in place of its own."""
        beta, states, pose = start.beta, start.joint_states, start.T_camera_base
        if self.beta is not None:
            beta = torch.tensor(as_doubles(self.beta)).to(beta).expand_as(beta).clone()
        if self.joint_states is not None:
            known = torch.as_tensor(as_doubles(self.joint_states) / category.state_units).to(states)
            states = torch.where(known.isnan(), states, known)
        if self.gravity is not None:
            pose = _upright(pose, torch.tensor(as_doubles(self.gravity)).to(pose))
        return State(beta, states, pose)

    def free(self, category: Category, basis_size: int) -> Tensor:
        """Directions (P, F) that are left to be estimated."""
        held = False if self.joint_states is None else np.isfinite(as_numpy(self.joint_states)).tolist()
        gravity = None if self.gravity is None else as_doubles(self.gravity)
        return free_directions(len(category.joints), basis_size, self.beta is not None, held, gravity)


NOTHING_KNOWN = Known()


def information(covariance: np.ndarray) -> np.ndarray:
    """(D, D) inverse of a shape's covariance (D, D), which is zero where the shape was held fixed."""
    return np.linalg.inv(covariance if covariance.any() else HELD * np.eye(len(covariance)))


def check_is_known(known: Any) -> None:
    """Raises InputError for what is no ``Known``."""
    if not isinstance(known, Known):
        raise InputError(f"known: is {type(known).__name__}; give an omad.Known")


def check_known(known: Any, category: Category, basis_size: int) -> None:
    """Raises InputError for what is no ``Known``, for a wrong shape, for what are no numbers, and for joint states in
    other units."""
    check_is_known(known)
    shapes = {"beta": (basis_size,), "joint_states": (len(category.joints),), "gravity": (3,)}
    for name, shape in shapes.items():
        value = getattr(known, name)
        if value is None:
            continue
        found = numbers(value, *shape, what=f"known {name}", unknown=name == "joint_states")
        if (np.abs(found) > LARGEST).any():
            raise InputError(f"known {name}: holds numbers that are too large to mean anything")
    if known.joint_states is not None:
        told = zip(category.joints, as_numpy(known.joint_states), category.metric_limits, strict=True)
        for joint, state, limits in told:
            if np.isfinite(state):
                check_state(state, limits, f"known joint_states: {joint.name}")
    if known.gravity is not None:
        known.direction_of_gravity()
    if (hand := known.mirrored_probability) is not None:
        if not category.either_hand:
            raise InputError(f"known mirrored_probability: a {category.name} has one hand (either_hand); leave it out")
        if not 0 <= number(hand) <= 1:
            raise InputError(f"known mirrored_probability: {hand} is no probability; give 0 to 1")


@dataclass(frozen=True, eq=False)
class Near:
    """Where an object that was seen before is expected, and what is believed of its shape. Camera frame, metres."""

    T_camera_base: np.ndarray
    """(4, 4): the network looks in this frame, and the least squares starts in it."""
    joint_states: np.ndarray
    """(J,) where the least squares starts."""
    beta: np.ndarray
    """(D,) mean of the belief, in place of the category's."""
    beta_covariance: np.ndarray
    """(D, D) of the belief."""

    def mirrored(self) -> Self:
        """Of what is seen in a mirror in the camera's plane x = 0."""
        return replace(self, T_camera_base=mirrored(self.T_camera_base))

    def start(self, category: Category, like: Tensor) -> State:
        """In category units, a batch of one; dtype and device are those of ``like``."""
        pose = rigid(self.T_camera_base[:3, :3], self.T_camera_base[:3, 3] / category.metres_per_unit)
        values = (self.beta, np.asarray(self.joint_states, dtype=np.float64) / category.state_units, pose)
        return State(*(torch.as_tensor(value, dtype=like.dtype, device=like.device)[None] for value in values))


def _upright(pose: Tensor, gravity: Tensor) -> Tensor:
    """Turn each base (B, 4, 4) by the smallest rotation that brings its down direction to ``gravity``; one that stands
    on its head, about its x axis."""
    down = -pose[:, :3, 1]
    goal = (gravity / gravity.norm()).expand_as(down)
    axis = torch.linalg.cross(down, goal, dim=-1)
    sine, cosine = axis.norm(dim=-1, keepdim=True), (down * goal).sum(-1, keepdim=True)
    axis = torch.where(sine < LEAST, pose[:, :3, 0], axis / sine.clamp(min=LEAST))
    turn = so3_exp(axis * torch.atan2(sine, cosine))
    return make_transform(turn @ pose[:, :3, :3], pose[:, :3, 3])
