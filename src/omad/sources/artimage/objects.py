"""Objects of an ArtImage download: their joints, and their surface as points, brought to our canonical space.

The files are written for a left-handed world: a child's state turns it by minus that much. Every frame here is
right-handed, and every length in metres.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from ...categories import Category
from ...errors import InputError
from ...files import read_cloud
from ...geometry import make_transform
from ...objects import NEIGHBOURS, PointObject
from ...standard_views import ObjectTruth
from .joints import FileJoint, read_base_offset, read_joints
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
    unit = category.metres_per_unit
    joints = read_joints(layout.aligned_urdf(name), category)
    T_rest = _rest_transforms(layout, name, joints, rest_states, category)
    clouds = [_read_points(layout.points(name, part)) for part in range(len(T_rest))]
    clouds = [cloud @ T[:3, :3].T + T[:3, 3] for cloud, T in zip(clouds, T_rest, strict=True)]
    every = np.concatenate(clouds)
    centre = (every.min(0) + every.max(0)) / 2
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
        truth=ObjectTruth(name, axes, pivots, limits, np.stack([[cloud.min(0), cloud.max(0)] for cloud in clouds])),
        links=links,
        T_canonical_base=make_transform(torch.as_tensor(R), torch.as_tensor(t * unit)).numpy(),
        signs=np.array([-1.0 if joint.revolute else 1.0 for joint in joints]) * against,
    )


def _rest_transforms(
    layout: Layout, name: str, joints: Sequence[FileJoint], rest_states: dict[str, Any], category: Category
) -> list[np.ndarray]:
    """(4, 4) per link of the files: its model frame -> at rest, before the box is centred; in the file's units."""
    D = read_base_offset(layout, name) if peculiarities(category).base_offset else np.eye(4)
    result = [D]
    for joint in joints:
        state, T = _rest_state(layout, rest_states, name, joint), np.eye(4)
        if joint.revolute:  # left-handed
            T[:3, :3] = Rotation.from_rotvec(-state * joint.axis).as_matrix()
            T[:3, 3] = joint.pivot - T[:3, :3] @ joint.pivot
        else:
            T[:3, 3] = state * joint.axis
        result.append(D @ T)
    return result


def _read_points(path: Path) -> np.ndarray:
    points = read_cloud(path)
    if len(points) < NEIGHBOURS or not np.isfinite(points).all():
        raise InputError(f"{path}: {len(points)} points; expected at least {NEIGHBOURS}, all finite; download it again")
    return points


def _rest_state(layout: Layout, record: dict[str, Any], name: str, joint: FileJoint) -> float:
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


def _links(joints: Sequence[FileJoint], clouds: Sequence[np.ndarray], category: Category) -> tuple[int, ...]:
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


def _limits(joints: Sequence[FileJoint], against: np.ndarray, category: Category) -> np.ndarray:
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
