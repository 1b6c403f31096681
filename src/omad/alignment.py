"""Canonical alignment: find a foreign model's rest state and canonical frame from its geometry.

The first joint's axis gives one canonical direction. Around it, the flat faces of the base give two more,
up to quarter turns. Which of the eight frames that leaves is canonical, the category's spec tells: where
the child reaches from its joint, on which side of its parent it lies, which way its joint moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .categories import Category, JointSpec
from .errors import InputError
from .objects import Mesh, ObjectModel
from .urdf import RawArticulation

NEAR_LIMIT = math.radians(10)
"""A closed state this near to a stated limit is that limit: limits are exact, faces may slope."""
LEAST_AGREEMENT = 0.3
"""Cosine below which a child does not lie where the spec says: the object is of another kind."""
LEAST_TRAVEL = 0.1
"""Share of the spec's range of states that an object's joint must cover."""


SHORT = 0.1
"""Share of the object's diagonal below which a distance says little about its direction."""


def align(labellings: Sequence[RawArticulation], category: Category) -> ObjectModel:
    """Bring an articulation to canonical space.

    Each labelling has the category's parts as its links and the category's joints as its joints, in order;
    the one that fits the spec best is taken. Raises InputError, without a file's name, where none is shaped
    or jointed like the category's.
    """
    best = max(
        (candidate for raw in labellings for candidate in _candidates(raw, category)),
        key=lambda candidate: candidate.score,
    ).model
    _check(best, category)
    return _settled(_limited(best, category).centred())


@dataclass(frozen=True)
class _Candidate:
    model: ObjectModel
    score: float
    """How well it fits the spec."""


def _candidates(raw: RawArticulation, category: Category) -> Iterator[_Candidate]:
    """The object at rest in every frame that might be canonical."""
    model = _as_model(raw, category)
    rest = [
        _rest_state(category, joint, model.parts[spec.parent], model.parts[joint + 1], model)
        for joint, spec in enumerate(category.joints)
    ]
    at_rest = _zero_at(model, np.array(rest))
    for R in _frames(at_rest, category):
        turned = _signed(_turned(at_rest, R), category)
        # most sources have z up: that decides where geometry does not
        up = 0.05 * R[1, 2]
        yield _Candidate(turned, float(_agreement(turned, category).mean() + _travel(turned, category).mean() + up))


def _as_model(raw: RawArticulation, category: Category) -> ObjectModel:
    """The raw model as it stands, in its own frame; limits that it does not state are NaN."""
    return ObjectModel(
        name=raw.name,
        category=category.name,
        part_names=tuple(part.name for part in category.parts),
        parts=tuple(link.mesh for link in raw.links),
        joint_names=tuple(joint.name for joint in category.joints),
        tree=category.tree,
        axes=np.stack([joint.axis for joint in raw.joints]),
        pivots=np.stack([joint.pivot for joint in raw.joints]),
        limits=np.array([joint.limits or (np.nan, np.nan) for joint in raw.joints], dtype=np.float64),
    )


def _zero_at(model: ObjectModel, states: np.ndarray) -> ObjectModel:
    """The same object, its joints' zero moved to ``states`` (J,)."""
    G = model.part_transforms(states)
    parents = list(model.tree.parents)
    return replace(
        model,
        parts=tuple(Mesh(v, part.faces) for v, part in zip(model.posed_vertices(states), model.parts, strict=True)),
        axes=np.einsum("jab,jb->ja", G[parents, :3, :3], model.axes),
        pivots=np.einsum("jab,jb->ja", G[parents, :3, :3], model.pivots) + G[parents, :3, 3],
        limits=model.limits - states[:, None],
    )


def _turned(model: ObjectModel, R: np.ndarray) -> ObjectModel:
    return replace(
        model,
        parts=tuple(Mesh(part.vertices @ R.T, part.faces) for part in model.parts),
        axes=model.axes @ R.T,
        pivots=model.pivots @ R.T,
    )


def _signed(model: ObjectModel, category: Category) -> ObjectModel:
    """Turn round the joints whose axis points against the spec's."""
    against = (model.axes * [joint.axis for joint in category.joints]).sum(1, keepdims=True) < 0
    return replace(
        model,
        axes=np.where(against, -model.axes, model.axes),
        limits=np.where(against, -model.limits[:, ::-1], model.limits),
    )


# Rest states ---------------------------------------------------------------------------------------------------------


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


def _rest_state(category: Category, joint: int, parent: Mesh, child: Mesh, model: ObjectModel) -> float:
    kind, rule = model.tree.types[joint], category.rest[joint]
    if (kind, rule) not in _REST_RULES:
        raise InputError(f"category {category.name}: joint {joint} is {kind} and cannot rest {rule!r}; change its spec")
    axis, pivot, limits = model.axes[joint], model.pivots[joint], model.limits[joint]
    return _REST_RULES[kind, rule](parent, child, axis, pivot, limits)


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


_REST_RULES: dict[tuple[str, str], Callable[..., float]] = {
    ("revolute", "closed"): _closed_revolute,
    ("revolute", "perpendicular"): _perpendicular,
    ("revolute", "tips together"): _tips_together,
    ("prismatic", "closed"): _closed_prismatic,
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


# Frames --------------------------------------------------------------------------------------------------------------


def face_directions(mesh: Mesh, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two directions across ``axis`` that most of the surface faces or is parallel to, right-handed with it.

    Angles of face normals are taken modulo a quarter turn and the peak of their distribution by area is kept,
    so that hollow bodies, handles, rounded corners and noise do not tilt it.
    """
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    x, y = normals @ first, normals @ second
    facing = np.hypot(x, y) > 0.9 * area
    quarter = math.pi / 2
    angle, weight = np.arctan2(y[facing], x[facing]) % quarter, area[facing]

    bins = 360
    histogram = np.bincount((angle / quarter * bins).astype(int) % bins, weight, bins)
    kernel = np.exp(-0.5 * (np.minimum(np.arange(bins), bins - np.arange(bins)) / 8) ** 2)  # sigma 2 degrees
    smooth = np.fft.irfft(np.fft.rfft(histogram) * np.fft.rfft(kernel), bins)
    peak = (smooth.argmax() + 0.5) * quarter / bins
    for _ in range(10):
        offset = (angle - peak + quarter / 2) % quarter - quarter / 2
        share = weight * (np.abs(offset) < math.radians(5))
        peak += float((share * offset).sum() / max(share.sum(), 1e-30))
    along = math.cos(peak) * first + math.sin(peak) * second
    return along, np.cross(axis, along)


def tip_direction(mesh: Mesh, axis: np.ndarray, pivot: np.ndarray) -> np.ndarray:
    """Unit vector across ``axis`` from ``pivot`` to the tip of a long part that crosses there: its slimmer end."""
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    first /= np.linalg.norm(first)
    plane = np.stack([first, np.cross(axis, first)], 1)
    corners = (mesh.vertices[mesh.faces] - pivot) @ plane
    normals = np.cross(*np.moveaxis(mesh.vertices[mesh.faces][:, 1:] - mesh.vertices[mesh.faces][:, :1], 1, 0))
    weight = np.repeat(np.linalg.norm(normals, axis=1), 3) + 1e-30
    points = ((corners + np.roll(corners, 1, 1)) / 2).reshape(-1, 2)  # second moments are exact at edges' middles
    long = np.linalg.eigh((points * weight[:, None]).T @ points)[1][:, 1]

    def spread(way: np.ndarray) -> float:
        side = points @ way > 0
        return float(np.linalg.eigvalsh(np.cov(points[side].T, aweights=weight[side]))[0]) if side.sum() > 2 else 0.0

    way = min((long, -long), key=spread)
    ends = (mesh.vertices - pivot) @ plane
    reach = np.linalg.norm(ends, axis=1) * (ends @ way > 0)
    tip = plane @ ends[reach > 0.98 * reach.max()].mean(0)
    return tip / np.linalg.norm(tip)


def _frames(model: ObjectModel, category: Category) -> Iterator[np.ndarray]:
    """Rotations R (model to canonical) that bring the first axis to the spec's line and faces to faces, or tips
    that point the same way to +z."""
    target = np.array(category.joints[0].axis) / np.linalg.norm(category.joints[0].axis)
    side = np.cross(target, np.eye(3)[np.abs(target).argmin()])
    side /= np.linalg.norm(side)
    canonical = np.stack([target, side, np.cross(target, side)], 1)
    if category.rest[0] == "tips together":
        tips = sum(tip_direction(part, model.axes[0], model.pivots[0]) for part in model.parts[:2])
        front = tips / np.linalg.norm(tips)
        for axis in (model.axes[0], -model.axes[0]):
            yield np.stack([np.cross(axis, front), axis, front])
        return
    along, across = face_directions(model.parts[0], model.axes[0])
    for sign in (1.0, -1.0):
        for a, b in ((along, across), (across, -along), (-along, -across), (-across, along)):
            # the second sign turns the frame half about a, which keeps it right-handed
            yield canonical @ np.stack([sign * model.axes[0], a, sign * b])


def _agreement(model: ObjectModel, category: Category) -> np.ndarray:
    """Cosines between where children are and where the spec says they are; nearer to 1 where they are close by."""
    centres = model.part_boxes().mean(1)
    diagonal, found = model.diagonal, [1.0]
    for joint, spec in enumerate(category.joints):
        axis = model.axes[joint]
        reach = centres[joint + 1] - model.pivots[joint]
        across = reach - axis * (reach @ axis)  # a pivot may be anywhere on its axis
        for offset, expected in ((across, spec.reach), (centres[joint + 1] - centres[spec.parent], spec.side)):
            if expected is not None:
                length = float(np.linalg.norm(offset))
                cosine = offset @ np.array(expected) / max(length * np.linalg.norm(expected), 1e-12)
                found.append(1 - min(1.0, length / (SHORT * diagonal)) * (1 - cosine))
    return np.array(found)


def _travel(model: ObjectModel, category: Category) -> np.ndarray:
    """(J,) share of the spec's range of states that the object's limits cover; 1 where it states none."""
    spec = _spec_limits(category)
    low, high = np.maximum(model.limits[:, 0], spec[:, 0]), np.minimum(model.limits[:, 1], spec[:, 1])
    return np.nan_to_num(np.clip(high - low, 0, None) / (spec[:, 1] - spec[:, 0]), nan=1.0)


def _spec_limits(category: Category) -> np.ndarray:
    """(J, 2) radians or metres."""

    def metric(joint: JointSpec) -> np.ndarray:
        return np.array(joint.limits) * (category.metres_per_unit if joint.type == "prismatic" else 1.0)

    return np.stack([metric(joint) for joint in category.joints])


def _check(model: ObjectModel, category: Category) -> None:
    if _agreement(model, category).min() < LEAST_AGREEMENT:
        raise InputError(f"its parts do not lie to each other as those of a {category.name} do")
    for joint, share in enumerate(_travel(model, category)):
        if share < LEAST_TRAVEL:
            low, high = model.limits[joint]
            raise InputError(
                f"joint {model.joint_names[joint]!r} moves from {low:.2f} to {high:.2f} from its rest state "
                f"(radians or metres), which hardly meets the range of a {category.name}"
            )


def _limited(model: ObjectModel, category: Category) -> ObjectModel:
    """Limits within the spec's; the spec's where the object states none."""
    spec = _spec_limits(category)
    low, high = np.fmax(model.limits[:, 0], spec[:, 0]), np.fmin(model.limits[:, 1], spec[:, 1])
    return replace(model, limits=np.stack([low, high], 1))


def _settled(model: ObjectModel) -> ObjectModel:
    """Pivots moved along their axes to where they are nearest to the origin, as any point of an axis will do."""
    along = (model.pivots * model.axes).sum(1, keepdims=True)
    return replace(model, pivots=model.pivots - along * model.axes)
