"""Canonical alignment: find a foreign model's rest state and canonical frame from its geometry.

The first joint's axis gives one canonical direction. Around it, the flat faces of the base give two more,
up to quarter turns. Which of the eight frames that leaves is canonical, the category's spec tells: where
the child reaches from its joint, on which side of its parent it lies, which way its joint moves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .categories import Category, JointSpec
from .directions import face_directions, tip_direction
from .errors import InputError
from .objects import Mesh, ObjectModel
from .rest_states import REST_RULES, rest_state
from .urdf import RawArticulation

EXACT = 1e-6
"""Share of the object's diagonal by which a canonical object may miss its place, and radians of its limits."""
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
    or jointed like the category's. What is canonical already, as our own files are, stays as it stands.
    """
    for joint, rule in zip(category.joints, category.rest, strict=True):
        if (joint.type, rule) not in REST_RULES:
            raise InputError(
                f"category {category.name}: joint {joint.name!r} is {joint.type} and cannot rest {rule!r};"
                " change its spec"
            )
    canonical = [_as_model(raw, category) for raw in labellings if _is_canonical(raw, category)]
    best = (
        canonical[0]
        if canonical
        else max(
            (candidate for raw in labellings for candidate in _candidates(raw, category)),
            key=lambda candidate: candidate.score,
        ).model
    )
    _check(best, category)
    return _settled(_limited(best, category).centred())


def _is_canonical(raw: RawArticulation, category: Category) -> bool:
    """Whether links are called like the parts, box and axes are in place, and limits are within the spec's."""
    if [link.name for link in raw.links] != [part.name for part in category.parts]:
        return False
    model, spec = _as_model(raw, category), _spec_limits(category)
    boxes = model.part_boxes()
    off = np.abs(boxes[:, 0].min(0) + boxes[:, 1].max(0)).max() / 2
    outside = np.maximum(spec[:, 0] - model.limits[:, 0], model.limits[:, 1] - spec[:, 1]).max()
    along = [
        axis @ joint.axis / np.linalg.norm(joint.axis) for axis, joint in zip(model.axes, category.joints, strict=True)
    ]
    # a limit that is not stated is NaN, which is not within anything
    return bool(
        off < EXACT * model.diagonal
        and outside < EXACT
        and min(along) > 0.9
        and _agreement(model, category).min() > LEAST_AGREEMENT
    )


@dataclass(frozen=True)
class _Candidate:
    model: ObjectModel
    score: float
    """How well it fits the spec."""


def _candidates(raw: RawArticulation, category: Category) -> Iterator[_Candidate]:
    """The object at rest in every frame that might be canonical."""
    model = _as_model(raw, category)
    rest = [
        rest_state(
            (spec.type, rule), model.parts[spec.parent], model.parts[joint + 1],
            model.axes[joint], model.pivots[joint], model.limits[joint],
        )
        for joint, (spec, rule) in enumerate(zip(category.joints, category.rest, strict=True))
    ]  # fmt: skip
    at_rest = _zero_at(model, np.array(rest))
    for R in _frames(at_rest, category):
        turned = _signed(_turned(at_rest, R), category)
        # most sources have z up, others y: that decides where geometry does not
        up = 0.05 * R[1, 2] + 0.02 * R[1, 1]
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


# Frames --------------------------------------------------------------------------------------------------------------


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
    sizes = np.ptp(model.part_boxes(), axis=1) / model.diagonal
    for part, size in zip(category.parts, sizes, strict=True):
        for letter, share, (least, most) in zip("xyz", size, part.sides or (), strict=False):
            if not least <= share <= most:
                raise InputError(
                    f"its {part.name} spans {share:.2f} of the object's diagonal along {letter},"
                    f" that of a {category.name} {least:g} to {most:g}"
                )
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
