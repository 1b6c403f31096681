"""Objects of an ArtImage download: their joints, and their surface as points, brought to our canonical space.

The files are written for a left-handed world: a triple "x y z" of a URDF means (y, z, x), and a child's state turns
it by minus that much. Every frame here is right-handed, and every length in metres.
"""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...categories import Category
from ...errors import InputError
from ...files import read_cloud
from ...objects import NEIGHBOURS, PointObject
from ...standard_views import ObjectTruth
from .layout import Layout, peculiarities, read_json

LEAST_RANGE = 0.1
"""Share of the spec's range that an object's limits must cover to be believed."""


@dataclass(frozen=True)
class ArtImageObject:
    """One object, in its category's canonical space, and what it takes to read its annotations."""

    surface: PointObject
    truth: ObjectTruth
    links: tuple[int, ...]
    """Per part of the category, its number in the files."""
    T_canonical_base: np.ndarray
    """(4, 4) base in its model frame -> canonical space."""
    signs: np.ndarray
    """(J,) canonical state per annotated state: +1 or -1."""

    def states(self, annotated: Sequence[float], category: Category) -> np.ndarray:
        """Joint states (J,) in radians or metres from the annotated ones, in the category's order of joints."""
        scale = [math.pi / 180 if j.type == "revolute" else category.metres_per_unit for j in category.joints]
        return self.signs * scale * np.array(annotated)


def read_rest_states(layout: Layout) -> dict[str, Any]:
    """rest_state.json: {object: {part: {"state": degrees or units}}}. Raises InputError where it is missing."""
    record = read_json(layout.rest_states)
    if not isinstance(record, dict):
        raise InputError(f"{layout.rest_states}: not an object of object ids; download it again")
    return record


def read_object(layout: Layout, name: str, rest_states: dict[str, Any], category: Category) -> ArtImageObject:
    """Object ``name`` (its id) in canonical space. Raises InputError naming the file that is missing or unfit."""
    if not layout.object(name).is_dir():
        raise InputError(f"{layout.object(name)}: unknown object id {name}: no such folder; download it again")
    joints = _read_joints(layout.aligned_urdf(name), category)
    unit = category.metres_per_unit
    axes, pivots = np.stack([j.axis for j in joints]), np.stack([j.pivot for j in joints]) * unit
    rest = [_rest_state(layout, rest_states, name, j) * (1.0 if j.revolute else unit) for j in joints]
    clouds = [_read_points(layout.points(name, part)) * unit for part in range(len(joints) + 1)]

    D = _base_offset(layout, name, unit) if peculiarities(category).base_offset else np.eye(4)
    shut = [_rest_transform(joint, pivot, state) for joint, pivot, state in zip(joints, pivots, rest, strict=True)]
    T_rest = np.stack([D, *(D @ T for T in shut)])
    clouds = [cloud @ T[:3, :3].T + T[:3, 3] for cloud, T in zip(clouds, T_rest, strict=True)]
    axes, pivots = axes @ D[:3, :3].T, pivots @ D[:3, :3].T + D[:3, 3]
    every = np.concatenate(clouds)
    centre = (every.min(0) + every.max(0)) / 2
    clouds, pivots = [cloud - centre for cloud in clouds], pivots - centre

    links = _links(joints, clouds, category)
    chosen = [link - 1 for link in links[1:]]
    joints, axes, pivots = [joints[i] for i in chosen], axes[chosen], pivots[chosen]
    clouds = [clouds[link] for link in links]
    against = np.where((axes * [spec.axis for spec in category.joints]).sum(1) < 0, -1.0, 1.0)
    revolute = np.array([joint.revolute for joint in joints])
    limits = _limits(joints, against, category)
    truth = ObjectTruth(
        name=name,
        axes=against[:, None] * axes,
        pivots=pivots,
        limits=limits,
        part_boxes=np.stack([[cloud.min(0), cloud.max(0)] for cloud in clouds]),
    )
    centred = D.copy()
    centred[:3, 3] -= centre
    return ArtImageObject(
        surface=PointObject.from_clouds(name, clouds, truth.axes, truth.pivots, limits),
        truth=truth,
        links=links,
        T_canonical_base=centred,
        signs=np.where(revolute, -against, against),
    )


def _read_points(path: Path) -> np.ndarray:
    points = read_cloud(path)
    if len(points) < NEIGHBOURS or not np.isfinite(points).all():
        raise InputError(f"{path}: {len(points)} points; expected at least {NEIGHBOURS}, all finite; download it again")
    return points


@dataclass(frozen=True)
class _Joint:
    """As the file has it, right-handed; lengths in the file's units."""

    part: int
    revolute: bool
    axis: np.ndarray
    pivot: np.ndarray
    limits: tuple[float, float] | None
    """Degrees or units, zero at rest."""


def _read_joints(path: Path, category: Category) -> list[_Joint]:
    """The joint of every child part, by number."""
    found: dict[int, _Joint] = {}
    for element in _parse(path).iter("joint"):
        name, kind = element.get("name", ""), element.get("type")
        if kind == "fixed":
            continue
        try:
            part = int(name.rsplit("_", 1)[1])
            axis, limit = element.find("axis"), element.find("limit")
            direction = _permuted(_triple(axis, "xyz"))
            limits = None if limit is None else (float(limit.get("lower", "nan")), float(limit.get("upper", "nan")))
            pivot = _permuted(_triple(element.find("origin"), "xyz"))
            length = np.linalg.norm(direction)
            if not length > 0:
                raise ValueError("its axis has no direction")
        except (ValueError, IndexError) as error:
            raise InputError(
                f"{path}: joint {name!r} is not readable ({error}); expected a name that ends in _<part>,"
                " an origin and an axis"
            ) from error
        found[part] = _Joint(part, kind != "prismatic", direction / length, pivot, limits)
    wanted = list(range(1, len(category.parts)))
    if sorted(found) != wanted:
        raise InputError(
            f"{path}: moves the parts {sorted(found)}, those of a {category.name} are {wanted}; leave it out"
        )
    return [found[part] for part in wanted]


def _parse(path: Path) -> ElementTree.Element:
    if not path.is_file():
        raise InputError(f"{path}: missing; download it again")
    try:
        return ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, OSError) as error:
        raise InputError(f"{path}: broken XML ({error}); download it again") from error


def _triple(element: ElementTree.Element | None, key: str) -> np.ndarray:
    """(3,); an origin that is not written is zero."""
    values = np.array([float(word) for word in ("0 0 0" if element is None else element.get(key, "0 0 0")).split()])
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError(f"{key} needs three finite numbers")
    return values


def _permuted(triple: np.ndarray) -> np.ndarray:
    """The file's "x y z" means (y, z, x)."""
    return triple[[1, 2, 0]]


def _rest_state(layout: Layout, record: dict[str, Any], name: str, joint: _Joint) -> float:
    """Radians or units by which a child is off its rest state; 0 for a revolute object that is not listed."""
    if name not in record and joint.revolute:
        return 0.0
    try:
        state = float(record[name][str(joint.part)]["state"])
        if not math.isfinite(state):
            raise ValueError
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{layout.rest_states}: no state of part {joint.part} of object {name}; download it again"
        ) from error
    return math.radians(state) if joint.revolute else state


def _rest_transform(joint: _Joint, pivot: np.ndarray, state: float) -> np.ndarray:
    """(4, 4) child in its model frame -> at rest. A left-handed turn by ``state``, or a shift by it."""
    T = np.eye(4)
    if joint.revolute:
        T[:3, :3] = Rotation.from_rotvec(-state * joint.axis).as_matrix()
        T[:3, 3] = pivot - T[:3, :3] @ pivot
    else:
        T[:3, 3] = state * joint.axis
    return T


def _base_offset(layout: Layout, name: str, unit: float) -> np.ndarray:
    """(4, 4) D: how the origin of joint_0 moved between the plain and the aligned URDF."""
    origins = []
    for path in (layout.plain_urdf(name), layout.aligned_urdf(name)):
        origin = _parse(path).find("joint[@name='joint_0']/origin")
        if origin is None:
            raise InputError(f"{path}: no origin of joint_0; download it again")
        try:
            x, y, z = _triple(origin, "xyz")
            r, p, w = _triple(origin, "rpy")
        except ValueError as error:
            raise InputError(f"{path}: the origin of joint_0 is not readable ({error}); download it again") from error
        origins.append(np.array([-x, z, -y, -r, w, -p]))
    moved = origins[1] - origins[0]
    D = np.eye(4)
    D[:3, :3] = Rotation.from_euler("ZXY", moved[3:]).as_matrix()
    D[:3, 3] = moved[:3] * unit
    return D


def _links(joints: Sequence[_Joint], clouds: Sequence[np.ndarray], category: Category) -> tuple[int, ...]:
    """The files' number of each of the category's parts: children lie on the sides that the spec gives them."""
    if any(spec.parent for spec in category.joints):
        raise InputError(f"ArtImage's layout hangs every part on the base; those of a {category.name} do not")
    centres = np.stack([(cloud.min(0) + cloud.max(0)) / 2 for cloud in clouds])
    sides = np.array([spec.side or (0.0, 0.0, 0.0) for spec in category.joints])

    revolute = [spec.type == "revolute" for spec in category.joints]
    orders = itertools.permutations(range(1, len(clouds)))
    orders = [order for order in orders if [joints[link - 1].revolute for link in order] == revolute]
    if not orders:
        raise InputError(f"its joints are not of the types that a {category.name} has; leave it out")
    best = max(orders, key=lambda order: float(((centres[list(order)] - centres[0]) * sides).sum()))
    return 0, *best


def _limits(joints: Sequence[_Joint], against: np.ndarray, category: Category) -> np.ndarray:
    """(J, 2) radians or metres: the object's within the spec's; the spec's where the object's cannot be right."""
    result = []
    for joint, sign, spec in zip(joints, against, category.joints, strict=True):
        low, high = np.array(spec.limits)
        if joint.limits is not None:
            own = sorted(sign * (math.radians(v) if joint.revolute else v) for v in joint.limits)
            if min(high, own[1]) - max(low, own[0]) >= LEAST_RANGE * (high - low):
                low, high = max(low, own[0]), min(high, own[1])
        unit = 1.0 if joint.revolute else category.metres_per_unit
        result.append((low * unit, high * unit))
    return np.array(result)
