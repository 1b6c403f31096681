"""Canonical alignment: find a foreign model's rest state and canonical frame from its geometry.

The first joint's axis gives one canonical direction. Around it, the flat faces of the base give two more,
up to quarter turns. Which of the eight frames that leaves is canonical, the category's spec tells: where
the child reaches from its joint, on which side of its parent it lies, which way its joint moves.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from omad.common.errors import InputError
from omad.geometry.directions import face_directions
from omad.geometry.rigid import across, split, unit
from omad.geometry.transforms import MIRROR_X
from omad.objects.category import Category, JointSpec
from omad.objects.model import ObjectModel

from .articulation import RawArticulation, as_model
from .reaching import reaching_states
from .rest_states import rest_state, snapped, tip_directions

EXACT = 1e-6
"""Share of the object's diagonal by which a canonical object may miss its place, and radians of its limits."""
LEAST_AGREEMENT = 0.3
"""Cosine below which a child does not lie where the spec says: the object is of another kind."""
MIDDLE = 0.1
"""Share of a part's length by which its middle has to be away from its hinge: else it is a swing lid, a see-saw."""
LEAST_TRAVEL, LEAST_INSIDE = 0.1, 0.5
"""Share of the spec's range of states that an object's joint must cover, or share of its own that must be in there."""
HARDLY = 0.02
"""Share of the spec's range below which a joint does not move."""
UP = np.array([0.001, 0.02, 0.05])
"""How far it speaks for a frame that the source's x, y or z is up in it: most sources have z up, others y. That decides
where geometry does not; a right-hinged door on its head is a left-hinged one."""
FAR = 0.01
"""How far a radian to where parts reach as they should speaks against a frame: that decides where no limits do."""
HARDLY_TOLD = 0.1
"""How much the places of drawers tell beside their order."""
SHORT = 0.1
"""Share of the object's diagonal below which a distance says little about its direction."""


@dataclass(frozen=True)
class Aligned:
    """An object in canonical space."""

    model: ObjectModel
    R_canonical_source: np.ndarray
    """(3, 3) how it was turned, or turned and mirrored."""
    as_it_stood: bool = False
    """Whether it was in canonical space already."""

    @property
    def mirrored(self) -> bool:
        """Whether it is the mirror image of what stands in the file."""
        return bool(np.linalg.det(self.R_canonical_source) < 0)


def align(ways: Iterable[Sequence[RawArticulation]], category: Category) -> Aligned:
    """Bring an articulation to canonical space.

    The first of the ways to take it that is shaped and jointed like the category's counts. Of each, every labelling has
    the category's parts as its links and the category's joints as its joints, in order; the one that fits the spec best
    is taken. Raises InputError, without a file's name, with what is wrong with the first way, where none fits.
    What is canonical already, as our own files are, stays as it stands.
    """
    refusals = []
    for labellings in ways:
        try:
            return _aligned(labellings, category)
        except InputError as refusal:
            refusals.append(refusal)
    raise refusals[0]


def _aligned(labellings: Sequence[RawArticulation], category: Category) -> Aligned:
    found = next((as_model(raw, category) for raw in labellings if _is_canonical(raw, category)), None)
    best, R = found, np.eye(3)
    if best is None:
        models = [(as_model(raw, category), np.eye(3)) for raw in labellings]
        models += [(model.mirrored(), np.diag(MIRROR_X)) for model, _ in models if category.either_hand]
        candidates = (each for model, image in models for each in _candidates(model, image, category))
        best, R, _ = max(candidates, key=lambda candidate: candidate[2])
    check_like(best, category)
    # limits within the spec's; the spec's where the object states none
    spec = category.metric_limits
    limits = np.stack([np.fmax(best.limits[:, 0], spec[:, 0]), np.fmin(best.limits[:, 1], spec[:, 1])], 1)
    names = tuple(joint.name for joint in category.joints)
    model = replace(best, limits=limits, joint_names=names).centred()
    # pivots move along their axes to where they are nearest to the origin, as any point of an axis will do
    along = (model.pivots * model.axes).sum(1, keepdims=True)
    return Aligned(replace(model, pivots=model.pivots - along * model.axes), R, found is not None)


def _is_canonical(raw: RawArticulation, category: Category) -> bool:
    """Whether links are called like the parts, box and axes are in place, and limits are within the spec's."""
    if [link.name for link in raw.links] != [part.name for part in category.parts]:
        return False
    model, spec = as_model(raw, category), category.metric_limits
    boxes = model.part_boxes()
    off = np.abs(boxes[:, 0].min(0) + boxes[:, 1].max(0)).max() / 2
    outside = np.maximum(spec[:, 0] - model.limits[:, 0], model.limits[:, 1] - spec[:, 1]).max()
    along = (model.axes * category.axes).sum(1)
    # a limit that is not stated is NaN, which is not within anything
    in_place = off < EXACT * model.diagonal and outside < EXACT and along.min() > 0.9
    return bool(in_place and _agreement(model, category, _telling_asides(model, category)).min() > LEAST_AGREEMENT)


def _candidates(
    model: ObjectModel, R_model_source: np.ndarray, category: Category
) -> Iterator[tuple[ObjectModel, np.ndarray, float]]:
    """The object at rest in every frame that might be canonical, the turn into it from the source's frame, and how well
    it fits the spec."""
    rest, images = [], _between_images(model, category)
    joints = zip(category.joints, model.parts[1:], model.axes, model.pivots, model.limits, strict=True)
    for spec, child, axis, pivot, limits in joints:
        facing = None if images is None or spec.parent else unit(split(images[1], axis)[1])
        placed = (model.parts[spec.parent], child, axis, pivot, limits)
        state = rest_state(spec.motion, spec.rest, *placed, facing)
        # where rest is the end of the way, as of unfolded temples, the file tells it better than shapes
        rest.append(snapped(state, limits) if spec.motion.turns and 0.0 in spec.limits else state)
    at_rest = model.with_zero_at(np.array(rest))
    for R_canonical_model in _frames(at_rest, category):
        turned, R = _turned(at_rest, R_canonical_model, category), R_canonical_model @ R_model_source
        states = reaching_states(turned, category)
        if states.any():
            turned = turned.with_zero_at(states)
        fit = _agreement(turned, category, _choosing_asides(turned, category)).mean() + _travel(turned, category).mean()
        yield turned, R, float(fit + R[1] @ UP - FAR * np.abs(states).sum())


def _turned(model: ObjectModel, R: np.ndarray, category: Category) -> ObjectModel:
    """The object in the frame that ``R`` (3, 3) takes it to; joints whose axis points against the spec's turn round."""
    axes = model.axes @ R.T
    against = (axes * category.axes).sum(1, keepdims=True) < 0
    return replace(
        model,
        parts=tuple(part.warped(lambda vertices: vertices @ R.T) for part in model.parts),
        axes=np.where(against, -axes, axes),
        pivots=model.pivots @ R.T,
        limits=np.where(against, -model.limits[:, ::-1], model.limits),
    )


def _frames(model: ObjectModel, category: Category) -> Iterator[np.ndarray]:
    """Rotations R (model to canonical) that bring the first axis to the spec's line and faces to faces, or tips
    that point the same way to +z."""
    target = unit(np.array(category.joints[0].axis))
    canonical = np.stack([target, *across(target)], 1)
    if category.joints[0].rest == "tips together":
        base, child = model.parts[:2]
        front = unit(np.add(*tip_directions(base, child, model.axes[0], model.pivots[0], model.limits[0])))
        for axis in (model.axes[0], -model.axes[0]):
            yield np.stack([np.cross(axis, front), axis, front])
        return
    if images := _between_images(model, category):
        axis, first = images
    else:
        shut = [part for part, spec in zip(model.parts[1:], category.joints, strict=True) if spec.rest == "closed"]
        axis, first = model.axes[0], face_directions(model.parts[0], model.axes[0], shut)[0]
    second = np.cross(axis, first)
    for sign in (1.0, -1.0):
        for a, b in ((first, second), (second, -first), (-first, -second), (-second, first)):
            # the second sign turns the frame half about a, which keeps it right-handed
            yield canonical @ np.stack([sign * axis, a, sign * b])


def _between_images(model: ObjectModel, category: Category) -> tuple[np.ndarray, np.ndarray] | None:
    """Where the first joint is a hinge whose image in the plane x = 0 is another one: the axis (3,) of both together,
    and the way (3,) from one to the other, which is along x as the faces of a bent frame of spectacles are not."""
    spec, image = category.joints[0], category.parts[1].mirror
    if not spec.motion.turns or image is None or image < 2:
        return None
    axis, other = model.axes[0], model.axes[image - 1]
    axis = unit(axis + other * np.sign(axis @ other))
    apart = split(model.pivots[image - 1] - model.pivots[0], axis)[1]
    return (axis, unit(apart)) if np.linalg.norm(apart) > SHORT * model.diagonal else None


def _agreement(model: ObjectModel, category: Category, asides: np.ndarray) -> np.ndarray:
    """Cosines between where children are and where the spec says they are; nearer to 1 where they are close by."""
    return np.array([1.0, *(agreed for agreed, _ in _relations(model, category, asides).values())])


def _relations(
    model: ObjectModel, category: Category, asides: np.ndarray
) -> dict[tuple[str, str], tuple[float, np.ndarray]]:
    """The same of each part and field of its joint's spec, with where it is (3,); ``asides`` (J, 3) from their parents'
    middles."""
    centres, diagonal, found = model.part_boxes().mean(1), model.diagonal, {}
    for joint, spec in enumerate(category.joints):
        reach = centres[joint + 1] - model.pivots[joint]
        beside = split(reach, model.axes[joint])[1]  # a pivot may be anywhere on its axis
        for field, offset, expected in (("reach", beside, spec.reach), ("side", asides[joint], spec.side)):
            if expected is not None:
                length = float(np.linalg.norm(offset))
                cosine = offset @ np.array(expected) / max(length * np.linalg.norm(expected), 1e-12)
                agreed = 1 - min(1.0, length / (SHORT * diagonal)) * (1 - cosine)
                found[category.parts[joint + 1].name, field] = agreed, offset
    return found


def _asides(model: ObjectModel) -> np.ndarray:
    """(J, 3) from the middle of each joint's parent to that of its child."""
    centres = model.part_boxes().mean(1)
    return centres[1:] - centres[list(model.tree.parents)]


def _choosing_asides(model: ObjectModel, category: Category) -> np.ndarray:
    """The same as far as it tells which frame is canonical. Of parts that slide beside each other, as drawers do, it is
    their order that tells, and places hardly: a chest of two columns is wider than high, and yet stands."""
    slides = [spec.parent for spec in category.joints if not spec.motion.turns]
    rows = np.array([not spec.motion.turns and slides.count(spec.parent) > 1 for spec in category.joints])
    plain = _asides(model)
    if not rows.any():
        return plain
    told = HARDLY_TOLD * plain + (1 - HARDLY_TOLD) * _telling_asides(model, category)
    return np.where(rows[:, None], told, plain)


def _telling_asides(model: ObjectModel, category: Category) -> np.ndarray:
    """The same as far as it tells, in a frame that was chosen, what kind of object it is. A part that slides may lie
    anywhere across, one that turns anywhere along its hinge. Where the spec tells children of one part apart, their
    order counts and not how far apart they are: drawers may be of any height, and on legs."""
    apart, sides = _asides(model), np.array([joint.side or (0.0, 0.0, 0.0) for joint in category.joints])
    asides = np.stack([_told(*each) for each in zip(apart, sides, model.axes, category.joints, strict=True)])
    for parent in set(model.tree.parents):
        siblings = [i for i, spec in enumerate(category.joints) if spec.parent == parent and spec.side is not None]
        for axis in np.flatnonzero(np.ptp(sides[siblings], axis=0)) if siblings else ():
            said, places = sides[siblings, axis], apart[siblings, axis]
            even = np.sort(said)[places.argsort().argsort()] * np.ptp(places) / np.ptp(said)
            asides[siblings, axis] = even if np.ptp(places) > SHORT * model.diagonal else places
    return asides


def _told(apart: np.ndarray, side: np.ndarray, axis: np.ndarray, spec: JointSpec) -> np.ndarray:
    """(3,) what the place of a single part tells."""
    along, across = split(apart, axis)
    said_along, said_across = split(side, unit(np.array(spec.axis)))
    if not spec.motion.turns:
        way = said_across / max(np.linalg.norm(said_across), 1e-12)
        return along + way * (way @ across)
    return across if np.linalg.norm(said_along) < 1e-6 * np.linalg.norm(side) else apart


def _travel(model: ObjectModel, category: Category) -> np.ndarray:
    """(J,) share of the spec's range of states that the object's limits cover; 1 where it states none."""
    spec = category.metric_limits
    low, high = np.maximum(model.limits[:, 0], spec[:, 0]), np.minimum(model.limits[:, 1], spec[:, 1])
    return np.nan_to_num(np.clip(high - low, 0, None) / (spec[:, 1] - spec[:, 0]), nan=1.0)


def check_like(model: ObjectModel, category: Category) -> None:
    """Raises InputError, without a file's name, for an object in canonical space that is shaped or jointed otherwise
    than the category's."""
    for (part, field), (agreed, towards) in _relations(model, category, _telling_asides(model, category)).items():
        if agreed < LEAST_AGREEMENT:
            most = int(np.abs(towards).argmax())
            found = f"{'+' if towards[most] > 0 else '-'}{'xyz'[most]}"
            told = f"its {part} lies elsewhere than the spec's {field} says, mostly towards {found}"
            raise InputError(f"its parts do not lie to each other as those of a {category.name} do: {told}")
    children = zip(category.parts[1:], category.joints, model.parts[1:], model.axes, model.pivots, strict=True)
    for part, spec, mesh, axis, pivot in children:
        if spec.reach is not None and spec.motion.turns:
            along = (mesh.vertices - pivot) @ unit(split(np.array(spec.reach), axis)[1])
            if along.max() + along.min() < 2 * MIDDLE * np.ptp(along):
                raise InputError(f"its {part.name} turns about its middle, that of a {category.name} about one end")
    sizes = np.ptp(model.part_boxes(), axis=1) / model.diagonal
    for part, size in zip(category.parts, sizes, strict=True):
        for letter, share, (least, most) in zip("xyz", size, part.sides or (), strict=False):
            if not least <= share <= most:
                raise InputError(
                    f"its {part.name} spans {share:.2f} of the object's diagonal along {letter},"
                    f" that of a {category.name} {least:g} to {most:g}"
                )
    range_of = np.ptp(category.metric_limits, axis=1)
    own = np.nan_to_num(np.ptp(model.limits, axis=1), nan=np.inf)  # a joint that moves but a little may do so
    for joint, share in enumerate(_travel(model, category)):
        if share < min(LEAST_TRAVEL, LEAST_INSIDE * own[joint] / range_of[joint]) or share < HARDLY:
            own_range, spec_range = (_range(ends, category, joint) for ends in (model.limits, category.metric_limits))
            raise InputError(
                f"joint {model.joint_names[joint]!r} moves {own_range} from its rest state, that of a {category.name} "
                f"{spec_range}: turn its axis round, or mend its limits"
            )


def _range(limits: np.ndarray, category: Category, joint: int) -> str:
    """In words, of one of the category's joints of such ``limits`` (J, 2)."""
    low, high = limits[joint] + 0.0  # no -0
    return (
        f"{np.degrees(low):.0f}° to {np.degrees(high):.0f}°"
        if category.turning[joint]
        else f"{low:.3g} to {high:.3g} m"
    )
