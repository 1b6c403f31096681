"""The kinds of joint there are. This is the one place that knows their names.

To all other code a joint is two numbers: how far its child turns about the axis and how far it slides along the axis,
per unit of the joint's state.

    type        turn   slide          state
    revolute    1      0              radians
    prismatic   0      1              a length
    screw       1      pitch / 2 pi   radians; pitch is the length that a whole turn advances
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, Self, get_args

JointType = Literal["revolute", "prismatic", "screw"]
JOINT_TYPES: tuple[JointType, ...] = get_args(JointType)


@dataclass(frozen=True)
class Motion:
    """What one unit of a joint's state does to its child."""

    turn: float
    """Radians about the axis. Where it is not 0, the state is an angle and the axis has a place (a pivot)."""
    slide: float
    """Length along the axis, in the unit of length that the joint's pivot is in."""

    @property
    def turns(self) -> bool:
        """Whether the state is an angle and the axis has a place; if not, it is a length and only a direction."""
        return self.turn != 0

    def scaled(self, factor: float) -> Self:
        """The same motion where lengths are ``factor`` times as many; a state that is a length scales along."""
        return replace(self, slide=self.slide * factor) if self.turns else self

    def state_unit(self, length: float) -> float:
        """What one unit of state is where a unit of length is ``length``: 1 for an angle, ``length`` for a length."""
        return 1.0 if self.turns else length


REVOLUTE, PRISMATIC = Motion(1.0, 0.0), Motion(0.0, 1.0)


def motion_of(type: JointType, pitch: float | None = None) -> Motion:
    """The two numbers of a joint of this type; ``pitch`` is a screw's length a turn, signed, and no other joint's.

    Raises ValueError for an unknown type, and where the pitch is missing or too much.
    """
    if type not in JOINT_TYPES:
        raise ValueError(f"unknown joint type {type!r}, expected {', '.join(JOINT_TYPES)}")
    if (type == "screw") != (pitch is not None):
        raise ValueError(f"a {type} joint has {'a' if type == 'screw' else 'no'} pitch")
    if pitch is not None:
        if not 0 < abs(pitch) < math.inf:
            raise ValueError(f"pitch {pitch} must be a length other than 0")
        return Motion(1.0, pitch / (2 * math.pi))
    return REVOLUTE if type == "revolute" else PRISMATIC


def type_of(motion: Motion) -> JointType:
    """The name of a joint that moves like this."""
    if not motion.turns:
        return "prismatic"
    return "screw" if motion.slide else "revolute"


def elementary(motion: Motion) -> tuple[Motion, ...]:
    """Joints that only turn or only slide and, moved together, do the same: for formats that know no other. The first
    one's state is the joint's, a second one's is ``motion.slide`` times it."""
    return (REVOLUTE, PRISMATIC) if motion.turns and motion.slide else (motion,)
