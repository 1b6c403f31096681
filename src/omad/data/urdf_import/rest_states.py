"""Rest states by geometry: at which state of its joint a foreign model's part is closed, upright, or in line."""

import math
from collections.abc import Callable

import numpy as np

from omad.geometry.directions import face_directions, tip_direction
from omad.geometry.joint_kinds import Motion
from omad.geometry.mesh import Mesh
from omad.geometry.rigid import box
from omad.objects.category import RestRule

NEAR_LIMIT = math.radians(10)
"""A closed state this near to a stated limit is that limit: limits are exact, faces may slope."""


class _CrossSection:
    """A parent and its child seen along the joint's axis: 2-D points about the pivot, along the parent's faces."""

    def __init__(self, parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray) -> None:
        along, across = face_directions(parent, axis)
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


def _closed_turning(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray) -> float:
    """Faces parallel, whole box smallest, within reach of the joint; a limit near by is taken as it stands."""
    section = _CrossSection(parent, child, axis, pivot)
    states = [_wrapped(state, limits) for state in section.aligned]
    reachable = [state for state in states if _excess(state, limits) < 1.5 * NEAR_LIMIT]
    # a door folded into a hollow body would make an even smaller box, but for the overlap
    closed = min(reachable or states, key=lambda state: section.box_area(state) + 2 * section.overlap(state))
    return _snapped(closed, limits)


def _perpendicular(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray) -> float:
    """A quarter turn from where the child lies flat on its parent, away from it."""
    section = _CrossSection(parent, child, axis, pivot)
    closed = min(section.aligned, key=section.box_area)
    lying = section.child_at(closed)
    reach = box(lying).mean(0)
    offset = reach - box(section.parent).mean(0)
    away = np.array([-reach[1], reach[0]])  # where a positive quarter turn takes the child
    face = int(np.abs(away).argmax())
    outward = 1.0 if away[face] * offset[face] > 0 else -1.0
    options = [_wrapped(closed + sign * outward * math.pi / 2, limits) for sign in (1, -1)]
    return min(options, key=lambda state: _excess(state, limits) > NEAR_LIMIT)  # the first unless out of reach


def _closed_sliding(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray) -> float:
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


def _tips_together(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray) -> float:
    """Both parts point the same way; a limit near by is taken as it stands."""
    tip, moving = tip_direction(parent, axis, pivot), tip_direction(child, axis, pivot)
    state = math.atan2(np.cross(moving, tip) @ axis, moving @ tip)
    return _snapped(_wrapped(state, limits), limits)


def _zero(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray) -> float:
    """The source's own zero state, or the limit that is nearest to it."""
    return 0.0 if np.isnan(limits).any() else float(np.clip(0.0, *limits))


RULES: dict[tuple[bool, RestRule], Callable[..., float]] = {
    (True, "closed"): _closed_turning,
    (True, "perpendicular"): _perpendicular,
    (True, "tips together"): _tips_together,
    (True, "zero"): _zero,
    (False, "closed"): _closed_sliding,
    (False, "zero"): _zero,
}
"""By whether the joint turns, and the spec's rule."""


def rest_state(
    motion: Motion, rule: RestRule, parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray
) -> float:
    """The state, radians or metres, at which a joint is at rest by the spec's rule. Parent and child are given at the
    source's zero state, in one frame with the axis (3,) unit and the pivot (3,); the limits (2,) are NaN where the
    source states none. A screw is closed where it is screwed in."""
    if motion.turns and motion.slide and rule == "closed":
        return _closed_sliding(parent, child, axis, pivot, np.sort(limits * motion.slide)) / motion.slide
    return RULES[motion.turns, rule](parent, child, axis, pivot, limits)


def _snapped(state: float, limits: np.ndarray) -> float:
    stated = [limit for limit in limits if abs(limit - state) < NEAR_LIMIT]
    return float(min(stated, key=lambda limit: abs(limit - state))) if stated else state


def _wrapped(state: float, limits: np.ndarray) -> float:
    """The same angle within half a turn of the middle of the limits."""
    middle = 0.0 if np.isnan(limits).any() else limits.mean()
    return float(middle + (state - middle + math.pi) % (2 * math.pi) - math.pi)


def _excess(state: float, limits: np.ndarray) -> float:
    """How far ``state`` is outside of the limits."""
    return 0.0 if np.isnan(limits).any() else float(max(limits[0] - state, state - limits[1], 0.0))
