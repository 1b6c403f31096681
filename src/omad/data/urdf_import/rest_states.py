"""Rest states by geometry: at which state of its joint a foreign model's part is closed, upright, or in line."""

import itertools
import math
from collections.abc import Callable

import numpy as np

from omad.geometry.directions import end_directions, face_directions
from omad.geometry.joint_kinds import Motion
from omad.geometry.mesh import Mesh
from omad.geometry.rigid import box
from omad.objects.category import RestRule

NEAR_LIMIT = math.radians(10)
"""A closed state this near to a stated limit, or to the file's zero, is that: they are exact, faces may slope."""

OUT_OF_REACH = math.radians(20)
"""So far beyond its limits a joint makes up for an end that is wider by a factor of e."""
TINY = 1e-12
"""Metres: of parts without any width."""
FARTHER = 0.1
"""Share by which a state half a turn from the file's zero state has to be better than that."""

Facing = np.ndarray | None
"""(3,) unit, across a joint's axis: along which its parent faces; None where the parent's own faces tell."""


class _CrossSection:
    """A parent and its child seen along the joint's axis: 2-D points about the pivot, along the parent's faces."""

    def __init__(self, parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, facing: Facing) -> None:
        along = face_directions(parent, axis)[0] if facing is None else facing
        across = np.cross(axis, along)
        child_along, _ = face_directions(child, axis)
        plane = np.stack([along, across], 1)
        self.parent, self.child = (parent.vertices - pivot) @ plane, (child.vertices - pivot) @ plane
        """(V, 2) and, at state 0, (W, 2)."""
        turn = math.atan2(child_along @ across, child_along @ along)
        self.aligned = -turn + np.arange(4) * math.pi / 2
        """(4,) states at which the child's faces are parallel to the parent's, radians."""

    def child_at(self, state: float) -> np.ndarray:
        cos, sin = math.cos(state), math.sin(state)
        return self.child @ np.array([[cos, sin], [-sin, cos]])

    def box_area(self, state: float) -> float:
        """Area of the box of both."""
        low, high = self._corners(state)
        return float(np.prod(high.max(0) - low.min(0)))

    def overlap(self, state: float) -> float:
        """Area in which their boxes overlap."""
        low, high = self._corners(state)
        return float(np.prod(np.clip(high.min(0) - low.max(0), 0, None)))

    def _corners(self, state: float) -> np.ndarray:
        """(2, 2, 2) low and high corners of the parent's and of the child's box."""
        return np.stack([box(self.parent), box(self.child_at(state))], 1)


def _closed_turning(
    parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray, facing: Facing
) -> float:
    """Faces parallel, whole box smallest, within reach of the joint; a limit near by is taken as it stands."""
    section = _CrossSection(parent, child, axis, pivot, facing)
    states = [wrapped(state, limits) for state in section.aligned]
    reachable = [state for state in states if _excess(state, limits) < 1.5 * NEAR_LIMIT]

    def cost(state: float) -> float:
        # a door folded into a hollow body would make an even smaller box, but for the overlap; a lid that hangs down
        # behind makes one about as small as when it is shut
        return (section.box_area(state) + 2 * section.overlap(state)) * (1 + FARTHER * abs(state) / math.pi)

    return snapped(min(reachable or states, key=cost), limits)


def _perpendicular(
    parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray, facing: Facing
) -> float:
    """A quarter turn from where the child lies flat on its parent, away from it."""
    section = _CrossSection(parent, child, axis, pivot, facing)
    closed = min(section.aligned, key=section.box_area)
    lying = section.child_at(closed)
    reach = box(lying).mean(0)
    offset = reach - box(section.parent).mean(0)
    away = np.array([-reach[1], reach[0]])  # where a positive quarter turn takes the child
    face = int(np.abs(away).argmax())
    outward = 1.0 if away[face] * offset[face] > 0 else -1.0
    options = [wrapped(closed + sign * outward * math.pi / 2, limits) for sign in (1, -1)]
    return min(options, key=lambda state: _excess(state, limits) > NEAR_LIMIT)  # the first unless out of reach


def _closed_sliding(
    parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray, facing: Facing
) -> float:
    """The limit, or the zero state between them, at which the whole is shortest; zero where it hardly matters."""
    if np.isnan(limits).any():
        return 0.0
    fixed, sliding = parent.vertices @ axis, child.vertices @ axis

    def length(state: float) -> float:
        return max(fixed.max(), sliding.max() + state) - min(fixed.min(), sliding.min() + state)

    states = [0.0] if limits[0] <= 0 <= limits[1] else []
    states += [float(limit) for limit in limits]
    shortest = min(map(length, states))
    return next(state for state in states if length(state) <= 1.02 * shortest)


def _tips_together(
    parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray, facing: Facing
) -> float:
    """Both parts point the same way; a limit near by is taken as it stands."""
    tip, moving = tip_directions(parent, child, axis, pivot, limits)
    return snapped(_state_between(moving, tip, axis, limits), limits)


def tip_directions(
    parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors across ``axis`` from ``pivot`` to the tips of two long parts that cross there: to their slimmer
    ends, or to those that the limits (2,) let come together, as handles of pliers are as slim as jaws."""

    def doubt(ends: tuple[tuple[np.ndarray, float], tuple[np.ndarray, float]]) -> float:
        (tip, width), (moving, its_width) = ends
        beyond = _excess(_state_between(moving, tip, axis, limits), limits)
        return math.log(width + TINY) + math.log(its_width + TINY) + beyond / OUT_OF_REACH

    pairs = itertools.product(end_directions(parent, axis, pivot), end_directions(child, axis, pivot))
    (tip, _), (moving, _) = min(pairs, key=doubt)
    return tip, moving


def _zero(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray, facing: Facing) -> float:
    """The source's own zero state, or the limit that is nearest to it."""
    return 0.0 if np.isnan(limits).any() else float(np.clip(0.0, *limits))


RULES: dict[tuple[bool, RestRule], Callable[..., float]] = {
    (True, "closed"): _closed_turning,
    (True, "perpendicular"): _perpendicular,
    (True, "tips together"): _tips_together,
    (True, "zero"): _zero,
    (True, "reaching"): _zero,  # until the frame is known, in which to reach
    (False, "closed"): _closed_sliding,
    (False, "zero"): _zero,
}
"""By whether the joint turns, and the spec's rule."""


def rest_state(
    motion: Motion,
    rule: RestRule,
    parent: Mesh,
    child: Mesh,
    axis: np.ndarray,
    pivot: np.ndarray,
    limits: np.ndarray,
    facing: Facing = None,
) -> float:
    """The state, radians or metres, at which a joint is at rest by the spec's rule. Parent and child are given at the
    source's zero state, in one frame with the axis (3,) unit and the pivot (3,); the limits (2,) are NaN where the
    source states none. A screw is closed where it is screwed in. ``facing`` (3,): a unit vector across the axis along
    which the parent faces; left out, its faces tell."""
    if motion.turns and motion.slide and rule == "closed":
        return _closed_sliding(parent, child, axis, pivot, np.sort(limits * motion.slide), facing) / motion.slide
    return RULES[motion.turns, rule](parent, child, axis, pivot, limits, facing)


def snapped(state: float, limits: np.ndarray) -> float:
    """Of a joint that turns: the nearest of its limits and, between them, the file's zero, where one is near by."""
    exact = [*limits, 0.0] if limits[0] < 0 < limits[1] else limits
    near = [one for one in exact if abs(one - state) < NEAR_LIMIT]
    return float(min(near, key=lambda one: abs(one - state))) if near else state


def _state_between(moving: np.ndarray, tip: np.ndarray, axis: np.ndarray, limits: np.ndarray) -> float:
    """The state that turns ``moving`` to ``tip``."""
    return wrapped(math.atan2(np.cross(moving, tip) @ axis, moving @ tip), limits)


def wrapped(state: float, limits: np.ndarray) -> float:
    """The same angle within half a turn of the middle of the limits."""
    middle = 0.0 if np.isnan(limits).any() else limits.mean()
    return float(middle + (state - middle + math.pi) % (2 * math.pi) - math.pi)


def _excess(state: float, limits: np.ndarray) -> float:
    """How far ``state`` is outside of the limits."""
    return 0.0 if np.isnan(limits).any() else float(max(limits[0] - state, state - limits[1], 0.0))
