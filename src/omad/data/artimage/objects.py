"""Objects of an ArtImage download: their joints, and their surface as points, brought to our canonical space.

The files are written for a left-handed world: a child's state turns it by minus that much. Every frame here is
right-handed, and every length in metres.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omad.common.decode import Shape
from omad.common.errors import InputError
from omad.common.incoming import read_json
from omad.geometry.rigid import box, carry, rigid, turned_about
from omad.objects.category import Category
from omad.objects.model import NEIGHBOURS, PointObject
from omad.sensing.depth_files import read_cloud

from ..rendering.standard_views import ObjectTruth
from .joints import FileJoint, read_base_offset, read_joints
from .layout import AGAIN, Layout, peculiarities, require_flat_tree

FARTHEST = 1e6
"""Of coordinates, in the files' unit: beyond, distances mean nothing."""
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
        scale = [math.pi / 180 if turns else category.metres_per_unit for turns in category.turning]
        return self.signs * scale * np.array(annotated)


def read_rest_states(layout: Layout) -> dict[str, Any]:
    """rest_state.json: {object: {part: {"state": degrees or units}}}. Raises InputError where it is missing."""
    record = read_json(layout.rest_states, AGAIN)
    if not isinstance(record, dict):
        raise InputError(f"{layout.rest_states}: not an object of object ids; {AGAIN}")
    return record


def read_object(layout: Layout, name: str, rest_states: dict[str, Any], category: Category) -> ArtImageObject:
    """Object ``name`` (its id) in canonical space. Raises InputError naming the file that is missing or unfit."""
    if not layout.object(name).is_dir():
        raise InputError(f"{layout.object(name)}: unknown object id {name}: no such folder; {AGAIN}")
    unit = category.metres_per_unit
    joints = read_joints(layout.aligned_urdf(name), category)
    T_rest = [read_base_offset(layout, name) if peculiarities(category).base_offset else np.eye(4)]
    T_rest += [T_rest[0] @ _to_rest(layout, name, joint, rest_states) for joint in joints]
    clouds = [carry(T, _read_points(layout.points(name, part))) for part, T in enumerate(T_rest)]
    centre = box(np.concatenate(clouds)).sum(0) / 2
    links = _links(joints, clouds, category)
    clouds = [(clouds[link] - centre) * unit for link in links]

    R, t = T_rest[0][:3, :3], T_rest[0][:3, 3] - centre
    joints = [joints[link - 1] for link in links[1:]]
    axes = np.stack([R @ joint.axis for joint in joints])
    pivots = np.stack([R @ joint.pivot + t for joint in joints]) * unit
    against = np.where((axes * [spec.axis for spec in category.joints]).sum(1) < 0, -1.0, 1.0)
    axes, limits = against[:, None] * axes, _limits(joints, against, category)
    return ArtImageObject(
        surface=PointObject.from_clouds(name, clouds, axes, pivots, limits),
        truth=ObjectTruth(name, axes, pivots, limits, np.stack([box(cloud) for cloud in clouds])),
        links=links,
        T_canonical_base=rigid(R, t * unit),
        signs=np.array([-1.0 if joint.turns else 1.0 for joint in joints]) * against,
    )


def _to_rest(layout: Layout, name: str, joint: FileJoint, rest_states: dict[str, Any]) -> np.ndarray:
    """(4, 4) a child in its model frame -> at rest, before the box is centred; in the file's units."""
    state = _rest_state(layout, rest_states, name, joint)
    if joint.turns:  # left-handed
        return turned_about(Rotation.from_rotvec(-state * joint.axis).as_matrix(), joint.pivot)
    return rigid(np.eye(3), state * joint.axis)


def _read_points(path: Path) -> np.ndarray:
    points = read_cloud(path)
    if len(points) < NEIGHBOURS or not (np.abs(points) <= FARTHEST).all():
        wanted = f"at least {NEIGHBOURS}, none of them beyond {FARTHEST:g}"
        raise InputError(f"{path}: {len(points)} points; expected {wanted}; {AGAIN}")
    return points


def _rest_state(layout: Layout, record: dict[str, Any], name: str, joint: FileJoint) -> float:
    """Radians or units by which a child is off its rest state; 0 for an object with hinges that is not listed."""
    if name not in record and joint.turns:
        return 0.0
    try:
        state = float(Shape().array(record[name][str(joint.part)]["state"]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{layout.rest_states}: no state of part {joint.part} of object {name}; {AGAIN}") from error
    return math.radians(state) if joint.turns else state


def _links(joints: Sequence[FileJoint], clouds: Sequence[np.ndarray], category: Category) -> tuple[int, ...]:
    """The files' number of each of the category's parts: children lie on the sides that the spec gives them."""
    require_flat_tree(category)
    centres = np.stack([box(cloud).sum(0) / 2 for cloud in clouds])
    sides = np.array([spec.side or (0.0, 0.0, 0.0) for spec in category.joints])
    orders = itertools.permutations(range(1, len(clouds)))
    orders = [order for order in orders if tuple(joints[link - 1].turns for link in order) == category.turning]
    if not orders:
        raise InputError(f"its joints are not of the types that a {category.name} has; leave it out")
    return 0, *max(orders, key=lambda order: float(((centres[list(order)] - centres[0]) * sides).sum()))


def _limits(joints: Sequence[FileJoint], against: np.ndarray, category: Category) -> np.ndarray:
    """(J, 2) radians or metres: the object's within the spec's; the spec's where the object's cannot be right."""
    result = np.array([spec.limits for spec in category.joints], dtype=np.float64)
    for limits, joint, sign in zip(result, joints, against, strict=True):
        if joint.limits is not None:
            own = sorted(sign * (math.radians(v) if joint.turns else v) for v in joint.limits)
            low, high = max(limits[0], own[0]), min(limits[1], own[1])
            if high - low >= LEAST_RANGE * (limits[1] - limits[0]):
                limits[:] = low, high
    return result * category.state_units[:, None]
