"""Rest states by geometry: at which state of its joint a foreign model's part is closed, upright, or in line."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .directions import face_directions, tip_direction
from .kinematics import JointType
from .objects import Mesh

NEAR_LIMIT = math.radians(10)
"""A closed state this near to a stated limit is that limit: limits are exact, faces may slope."""


@dataclass(frozen=True)
class _CrossSection:
    """A parent and its child seen along a revolute axis: 2-D points about the pivot, along the parent's faces."""

    parent: np.ndarray
    """(V, 2)."""
    child: np.ndarray
    """(W, 2) at state 0."""
    aligned: np.ndarray
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
        return np.stack([_box(self.parent), _box(self.child_at(state))], 1)


def rest_state(
    joint: tuple[JointType, str], parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray
) -> float:
    """The state, radians or metres, at which a joint of this type and rest rule is at rest.

    ``parent`` and ``child`` at the source's zero state, in one frame with ``axis`` (3,) unit and ``pivot`` (3,);
    ``limits`` (2,) are NaN where the source states none.
    """
    return REST_RULES[joint](parent, child, axis, pivot, limits)


def _closed_revolute(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray) -> float:
    """Faces parallel, whole box smallest, within reach of the joint; a limit near by is taken as it stands."""
    section = _cross_section(parent, child, axis, pivot)
    states = [_wrapped(state, limits) for state in section.aligned]
    reachable = [state for state in states if _excess(state, limits) < 1.5 * NEAR_LIMIT]
    # a door folded into a hollow body would make an even smaller box, but for the overlap
    closed = min(reachable or states, key=lambda state: section.box_area(state) + 2 * section.overlap(state))
    return _snapped(closed, limits)


def _perpendicular(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray) -> float:
    """A quarter turn from where the child lies flat on its parent, away from it."""
    section = _cross_section(parent, child, axis, pivot)
    closed = min(section.aligned, key=section.box_area)
    lying = section.child_at(closed)
    reach = _box(lying).mean(0)
    offset = reach - _box(section.parent).mean(0)
    away = np.array([-reach[1], reach[0]])  # where a positive quarter turn takes the child
    face = int(np.abs(away).argmax())
    outward = 1.0 if away[face] * offset[face] > 0 else -1.0
    options = [_wrapped(closed + sign * outward * math.pi / 2, limits) for sign in (1, -1)]
    return min(options, key=lambda state: _excess(state, limits) > NEAR_LIMIT)  # the first unless out of reach


def _closed_prismatic(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray, limits: np.ndarray) -> float:
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


REST_RULES: dict[tuple[str, str], Callable[..., float]] = {
    ("revolute", "closed"): _closed_revolute,
    ("revolute", "perpendicular"): _perpendicular,
    ("revolute", "tips together"): _tips_together,
    ("revolute", "zero"): _zero,
    ("prismatic", "closed"): _closed_prismatic,
    ("prismatic", "zero"): _zero,
}


def _cross_section(parent: Mesh, child: Mesh, axis: np.ndarray, pivot: np.ndarray) -> _CrossSection:
    along, across = face_directions(parent, axis)
    child_along, _ = face_directions(child, axis)
    turn = math.atan2(child_along @ across, child_along @ along)
    plane = np.stack([along, across], 1)
    return _CrossSection(
        parent=(parent.vertices - pivot) @ plane,
        child=(child.vertices - pivot) @ plane,
        aligned=-turn + np.arange(4) * math.pi / 2,
    )


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


def _box(points: np.ndarray) -> np.ndarray:
    """(2, D) low and high corner."""
    return np.stack([points.min(0), points.max(0)])
