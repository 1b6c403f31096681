"""One joint of an observed object, in metres, radians and the camera frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from omad.common.arrays import number
from omad.common.errors import InputError
from omad.geometry.joint_kinds import Motion
from omad.geometry.rigid import rigid, turned_about
from omad.geometry.transforms import MIRROR_X
from omad.objects.pose import mirrored_axes

from .confidence.model import deviations

INTERVALS = (50, 90)
"""Per cent, of those that are written."""


def check_state(state: float, limits: Sequence[float], what: str) -> None:
    """Raises InputError, which begins with ``what``, for a state so far beyond the limits that it seems to be in other
    units."""
    low, high = limits
    if not 2 * low - high <= state <= 2 * high - low:
        raise InputError(f"{what}: {state:g} is far beyond {low:.2f} to {high:.2f}; give radians or metres")


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """One joint as seen now."""

    name: str
    """As in the category."""
    type: str
    """revolute, prismatic or screw."""
    state: float
    """Radians or metres; 0 at rest."""
    state_std: float
    """Its standard deviation: half the interval that holds the true state 68 % of the time."""
    limits: tuple[float, float]
    """Lowest and highest state, radians or metres."""
    axis: np.ndarray
    """(3,) unit, camera frame."""
    pivot: np.ndarray | None
    """(3,) a point of the axis, camera frame; None where the axis has no place: the joint only slides."""
    unit_motion: Motion
    """What a unit of state does: radians about the axis, metres along it."""
    tail: float = 1.0
    """The error is like ``state_std`` times this power of a normally distributed number: 1 of a normal distribution,
    more where a few answers are far off, as those seen the wrong way round."""

    def shown(self, value: float) -> str:
        """A state as a person reads it, degrees or centimetres, as in "12.3°"."""
        value = math.degrees(value) if self.pivot is not None else 100 * value
        return f"{round(value, 1) + 0.0:.1f}{'°' if self.pivot is not None else ' cm'}"  # 0.0: no minus before zero

    def __str__(self) -> str:
        spread = f" ± {self.shown(self.state_std)}" if math.isfinite(self.state_std) else ""
        return f"{self.name} {self.shown(self.state)}{spread}"

    def __repr__(self) -> str:
        low, high = map(self.shown, self.limits)
        return f"<{self} ({self.type}, {low} to {high})>"

    def mirrored(self) -> Self:
        """Of what is seen in a mirror in the camera's plane x = 0; the state keeps its sign."""
        [axis] = mirrored_axes(self.axis[None], [self.unit_motion.turns])
        return replace(self, axis=axis, pivot=None if self.pivot is None else self.pivot * MIRROR_X)

    def interval(self, level: float) -> tuple[float, float]:
        """What holds the true state with probability ``level``, as 0.9: around the estimated one, in its unit. Raises
        InputError for a level that is not between 0 and 1."""
        if not 0 < (told := number(level)) < 1:
            raise InputError(f"level: {level} is no probability between 0 and 1; give 0.9, say")
        half = self.state_std * deviations(told) ** self.tail
        return self.state - half, self.state + half

    @property
    def fraction(self) -> float:
        """How much of its travel the joint has made, 0 to 1 (and beyond, where it is): from the limit that is nearer
        to the rest state, so that a joint that rests closed says how far it is open."""
        low, high = self.limits
        near, far = (high, low) if abs(high) < abs(low) else (low, high)
        return (self.state - near) / (far - near)

    @property
    def twist(self) -> np.ndarray:
        """(6,) screw axis in the camera frame, (angular, linear) per unit of state: a point p of the moving part goes
        with ``linear + angular x p``."""
        angular, linear = self.unit_motion.turn * self.axis, self.unit_motion.slide * self.axis
        return np.concatenate([angular, linear if self.pivot is None else linear + np.cross(self.pivot, angular)])

    def motion(self, travel: float) -> np.ndarray:
        """(4, 4) camera to camera: where a point of the moving part is after ``travel`` (radians or metres) more."""
        along = rigid(np.eye(3), travel * self.unit_motion.slide * self.axis)
        if self.pivot is None:
            return along
        from scipy.spatial.transform import Rotation  # slow to import

        turn = Rotation.from_rotvec(travel * self.unit_motion.turn * self.axis)
        return along @ turned_about(turn.as_matrix(), self.pivot)

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it: the fields, with intervals, and what a turn of a screw advances."""
        values = {**vars(self), "fraction": self.fraction}
        known = math.isfinite(self.state_std)
        values |= {f"interval_{level}": self.interval(level / 100) if known else None for level in INTERVALS}
        motion = values.pop("unit_motion")
        del values["tail"]
        values |= {name: value.tolist() for name, value in values.items() if isinstance(value, np.ndarray)}
        return values | ({"pitch": 2 * math.pi * motion.slide / motion.turn} if motion.turns and motion.slide else {})
