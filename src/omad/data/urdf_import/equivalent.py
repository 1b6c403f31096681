"""The same movements, written with other joints: what one file says with two joints, another may say with one, and two
parts on one hinge may hang on each other in any order."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from omad.geometry.joint_kinds import Motion
from omad.geometry.rigid import diagonal
from omad.objects.category import Category

from .articulation import RawArticulation, RawJoint

PARALLEL = 0.999
"""Cosine from which two axes are of one direction."""
COAXIAL = 0.1
"""Share of the object's size by which hinges may be apart and count as one."""
PIN = 0.3
"""Share of its neighbours' sizes below which a link is a pin between them."""


def with_screws(raw: RawArticulation, category: Category) -> RawArticulation:
    """A joint that slides and one that turns about the same axis, with only an empty link between, as PartNet-Mobility
    has the lids of bottles, become one screw, where the category has one: of its pitch, which such files do not tell,
    and with the slide's limits."""
    screw = next((joint.motion for joint in category.joints if joint.motion.turn and joint.motion.slide), None)
    for outer in raw.joints if screw else ():
        inner = next((joint for joint in raw.joints if joint.child == outer.parent), None)
        between = inner is not None and not len(raw.links[inner.child].mesh.faces)
        if screw and inner and between and _one_axis(raw, inner, outer) and inner.motion.turns != outer.motion.turns:
            joint = _as_screw(*((inner, outer) if inner.motion.turns else (outer, inner)), screw)
            joint = replace(joint, name=outer.name, parent=inner.parent, child=outer.child)
            links = [link for link in range(len(raw.links)) if link != inner.child]
            others = {other.child: other for other in raw.joints} | {outer.child: joint}
            return with_screws(raw.with_links(links, [others[link] for link in links[1:]]), category)
    return raw


def without_pins(raw: RawArticulation) -> RawArticulation:
    """What hangs on a small link by the axis by which that hangs on another one, as one half of scissors on their
    screw, hangs on the other one itself."""
    sizes = [diagonal(link.mesh.vertices) if len(link.mesh.faces) else 0.0 for link in raw.links]

    def is_pin(link: int, *neighbours: int) -> bool:
        return sizes[link] < PIN * min(sizes[neighbour] for neighbour in neighbours)

    hung = [joint.child for joint in raw.joints if joint.parent == 0]
    if (
        len(hung) > 1
        and is_pin(0, *hung)
        and all(_one_axis(raw, raw.joints[hung[0] - 1], raw.joints[link - 1]) for link in hung)
    ):
        return without_pins(raw.rerooted(hung[0]))
    for outer in raw.joints:
        inner = next((joint for joint in raw.joints if joint.child == outer.parent), None)
        if (
            inner
            and inner.motion == outer.motion
            and is_pin(inner.child, inner.parent, outer.child)
            and _one_axis(raw, inner, outer)
        ):
            return without_pins(_with(raw, replace(outer, parent=inner.parent, limits=_added(outer, inner, 1))))
    return raw


def rehung(raw: RawArticulation) -> Iterator[RawArticulation]:
    """The articulation with one of two parts that turn about one hinge hung on the other one, or no longer on it, or
    the other way round. Turns about one axis add up, so that it moves as before, between other limits."""
    for joint in raw.joints:
        for other in raw.joints:
            if (
                other is joint
                or joint.motion != other.motion
                or not joint.motion.turns
                or not _one_axis(raw, joint, other)
            ):
                continue
            if other.parent == joint.parent:
                yield _with(raw, replace(joint, parent=other.child, limits=_added(joint, other, -1)))
            elif other.child == joint.parent:
                outer = replace(joint, parent=other.parent, limits=_added(joint, other, 1))
                yield _with(raw, outer)
                yield _with(raw, outer, joint.turned())


def _one_axis(raw: RawArticulation, a: RawJoint, b: RawJoint) -> bool:
    """Whether two joints have the same axis; one that only slides has no place."""
    if abs(a.axis @ b.axis) < PARALLEL:
        return False
    apart = np.linalg.norm(np.cross(a.pivot - b.pivot, a.axis))
    vertices = np.concatenate([link.mesh.vertices for link in raw.links])
    near = apart < COAXIAL * diagonal(vertices)
    return bool(near or not (a.motion.turns and b.motion.turns))


def _as_screw(turn: RawJoint, slide: RawJoint, motion: Motion) -> RawJoint:
    """The turn, which takes the slide along."""
    along = motion.slide * float(np.sign(turn.axis @ slide.axis))
    limits = None if slide.limits is None else tuple(sorted(limit / along for limit in slide.limits))
    return replace(turn, motion=motion, limits=limits)


def _added(joint: RawJoint, other: RawJoint, sign: int) -> tuple[float, float] | None:
    """Limits of the joint's state and, with this sign, that of the other one, about the joint's axis."""
    if joint.limits is None or other.limits is None:
        return None
    sign *= 1 if joint.axis @ other.axis > 0 else -1
    low, high = sorted(sign * limit for limit in other.limits)
    return joint.limits[0] + low, joint.limits[1] + high


def _with(raw: RawArticulation, *joints: RawJoint) -> RawArticulation:
    """The articulation with these joints to their children, parents before children again."""
    of = {joint.child: joint for joint in (*raw.joints, *joints)}
    order = [0]
    for link in order:
        order += [child for child, joint in of.items() if joint.parent == link]
    return raw.with_links(order, [of[link] for link in order[1:]])
