"""Which links of a foreign model are the category's parts: by name, by joint structure, then by size."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import perm, prod

import numpy as np
import torch

from omad.common.errors import InputError
from omad.geometry.joint_kinds import JOINT_TYPES
from omad.geometry.kinematics import KinematicTree, joint_transforms
from omad.geometry.mesh import Mesh, merge_meshes
from omad.geometry.rigid import across, box, carry, diagonal
from omad.objects.category import Category

from .alignment import MIDDLE
from .articulation import RawArticulation, RawJoint, RawLink
from .equivalent import rehung, with_screws, without_pins

COMPARABLE = 0.6
"""Links whose boxes' diagonals are at least in this ratio cannot be told apart by size."""

MOST_WAYS = 50_000
"""To choose links for the joints: a keyboard is no chest of drawers."""
CONTROLS = {"knob", "button", "switch", "wheel", "caster", "dial"}
"""Words for what is on an object to be handled, and is none of its parts unless the spec calls one so."""


@dataclass(frozen=True)
class _Assignment:
    raw: RawArticulation
    """Hung up at the link that is the base."""
    links: tuple[int, ...]
    """Link of each part."""
    named: int
    """How many parts' names agree."""
    size: float
    """Sum of the box diagonals of the children."""


def label_parts(raw: RawArticulation, category: Category) -> Iterator[list[RawArticulation]]:
    """Ways to take the articulation for one of the category, likeliest first: those that agree with most names, and of
    them the one that hangs as in the file. Each is reduced to the category's parts, in their order; several where only
    geometry can order them. Other links are folded into the part that carries them, in the state nearest to zero that
    their joint allows. Raises InputError, without the file's name, where links and joints do not fit the category."""
    raw = with_screws(without_pins(raw), category)
    if (
        ways := prod(perm(len(_links(raw, kind, category)), _wanted(category, kind)) for kind in JOINT_TYPES)
    ) > MOST_WAYS:
        raise InputError(f"its joints fit a {category.name} in {ways} ways; leave out those that are of none")
    plain, turned = [*_hung(raw, category)], [*_turned(raw, category)]
    named = max((a.named for way in (*plain, *turned) for a in way), default=0)
    none = True
    for lazy in (plain, _hung_otherwise(raw, category), turned):
        found = [*lazy]
        named = max([named, *(a.named for way in found for a in way)])
        for way in found:
            likely = _telling([a for a in way if a.named == named], category)
            if not likely:
                continue
            best, rivals = _best(likely)
            if not rivals:
                none = False
                yield [_folded(a, category) for a in likely if set(a.links) == set(best.links)]
            elif none:
                raise InputError(_rivals_of(best, rivals, category))
    if none:
        raise InputError(_why_none(raw, category))


def _hung(raw: RawArticulation, category: Category) -> Iterator[list[_Assignment]]:
    """Of the tree as in the file, then hung up at links called like the base."""
    for each in _from_bases(raw, category):
        yield [*_assignments(each, category)]


def _hung_otherwise(raw: RawArticulation, category: Category) -> Iterator[list[_Assignment]]:
    """With parts on one hinge hung on each other, or no longer."""
    for each in _from_bases(raw, category):
        for other in rehung(each):
            yield [*_assignments(other, category)]


def _turned(raw: RawArticulation, category: Category) -> Iterator[list[_Assignment]]:
    """Hung up at other links, from which the file's own root is a part that moves and carries none: some write a tree
    from the door."""
    types, carriers = {joint.type for joint in category.joints}, {joint.parent for joint in category.joints}
    for joint in raw.joints:
        if joint.type in types and _may_be(raw.links[joint.child], category, 0):
            turned = raw.rerooted(joint.child)
            root = next(place for place, link in enumerate(turned.links) if link is raw.links[0])
            yield [a for a in _assignments(turned, category) if root in a.links and a.links.index(root) not in carriers]


def _from_bases(raw: RawArticulation, category: Category) -> list[RawArticulation]:
    roots = [link for link in range(1, len(raw.links)) if _named(raw.links[link], category, 0)]
    return [raw, *(raw.rerooted(root) for root in roots)]


def _telling(way: list[_Assignment], category: Category) -> list[_Assignment]:
    """Those without what turns about its own middle, as turntables, drums and swivels do, for a part that reaches
    somewhere, unless it is called like that; all, where there are no others."""
    reaching = [part for part, spec in enumerate(category.joints, 1) if spec.reach is not None and spec.motion.turns]

    def spins(raw: RawArticulation, link: int, part: int) -> bool:
        pivot, plane = raw.joints[link - 1].pivot, np.stack(across(raw.joints[link - 1].axis), 1)
        low, high = box((raw.links[link].mesh.vertices - pivot) @ plane)
        centred = np.linalg.norm(low + high) < 2 * MIDDLE * (high - low).max()
        return bool(centred) and not _named(raw.links[link], category, part)

    return [a for a in way if not any(spins(a.raw, a.links[part], part) for part in reaching)] or way


def _best(way: list[_Assignment]) -> tuple[_Assignment, list[_Assignment]]:
    """The one of the largest links, and those of others that are hardly smaller."""
    best = max(way, key=lambda a: a.size)
    return best, [a for a in way if set(a.links) != set(best.links) and _comparable(a, best)]


def _rivals_of(best: _Assignment, rivals: list[_Assignment], category: Category) -> str:
    count, few = len(set(best.links[1:]).union(*(a.links[1:] for a in rivals))), len(best.links) - 1
    said = f"{count} links fit the part(s) {_moving(category)} equally well; {category.name} has {few}"
    return f"{said}: leave it out, or give a category that has {count}"


def _named(link: RawLink, category: Category, part: int) -> bool:
    """Whether an alias is in the link's name; inside of the category's own it does not count: no top in laptop_base."""
    said, words = " ".join(link.names).lower(), re.findall("[a-z]+", category.name.lower())

    def telling(alias: str) -> str:
        around = [re.escape(word) for word in words if alias in word and alias != word]
        return re.sub("|".join(around), "", said) if around else said

    return any(alias in telling(alias) for alias in category.parts[part].aliases)


def _control(link: RawLink) -> str | None:
    """What a link is called, where that is something to be handled and nothing more; numbered links have no name."""
    names = [name.lower() for name in link.names if not re.fullmatch(r"link[_-]?\d*", name.lower())]
    controls = [name for name in names if CONTROLS & {*re.findall("[a-z]+", name)}]
    return controls[0] if controls and len(controls) == len(names) else None


def _may_be(link: RawLink, category: Category, part: int) -> bool:
    """Whether a link can be a part at all."""
    return len(link.mesh.faces) > 0 and (_control(link) is None or _named(link, category, part))


def _assignments(raw: RawArticulation, category: Category) -> Iterator[_Assignment]:
    """Every way to find the category's tree in ``raw``, its root being the base."""

    def carried_by(link: int, links: tuple[int, ...]) -> int:
        return _carrier(raw, raw.joints[link - 1].parent, links)

    def extend(links: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        part = len(links)
        if part == len(category.parts):
            if all(
                carried_by(link, links) == links[spec.parent]
                for link, spec in zip(links[1:], category.joints, strict=True)
            ):
                yield links
            return
        spec = category.joints[part - 1]
        for joint in raw.joints:
            fits = joint.type == spec.type and _may_be(raw.links[joint.child], category, part)
            if joint.child not in links and fits and carried_by(joint.child, links) == links[spec.parent]:
                yield from extend((*links, joint.child))

    for links in extend((0,)):
        named = sum(_named(raw.links[link], category, part) for part, link in enumerate(links))
        yield _Assignment(raw, links, named, sum(_diagonal(raw.links[link]) for link in links[1:]))


def _carrier(raw: RawArticulation, link: int, links: tuple[int, ...]) -> int:
    """The nearest of ``links`` on the way from ``link`` to the root."""
    while link not in links:
        link = raw.joints[link - 1].parent
    return link


def _diagonal(link: RawLink) -> float:
    return diagonal(link.mesh.vertices)


def _comparable(a: _Assignment, b: _Assignment) -> bool:
    """Whether the links in which they differ are of about one size."""

    def differing(one: _Assignment, other: _Assignment) -> float:
        return min(_diagonal(one.raw.links[link]) for link in set(one.links) - set(other.links))

    return differing(a, b) >= COMPARABLE * differing(b, a)


def _links(raw: RawArticulation, kind: str, category: Category) -> list[RawLink]:
    """Those that move by joints of a kind, and can be one of the parts that do."""
    parts = [part for part, joint in enumerate(category.joints, 1) if joint.type == kind]
    moving = (raw.links[joint.child] for joint in raw.joints if joint.type == kind)
    return [link for link in moving if any(_may_be(link, category, part) for part in parts)]


def _wanted(category: Category, kind: str) -> int:
    return sum(joint.type == kind for joint in category.joints)


def _moving(category: Category) -> str:
    return ", ".join(part.name for part in category.parts[1:])


def _why_none(raw: RawArticulation, category: Category) -> str:
    for kind in JOINT_TYPES:
        found, wanted = _links(raw, kind, category), _wanted(category, kind)
        if len(found) < wanted:
            moving = [raw.links[joint.child] for joint in raw.joints if joint.type == kind]
            if not (controls := sorted({name for link in moving if (name := _control(link))})):
                return f"has {len(found)} {kind} joint(s) with a mesh, a {category.name} has {wanted}"
            lacking = f"{len(found)} of {wanted} part(s)" if found else "no"
            cure = f"where a {controls[0]} is that part, add this to the part's aliases, in a spec of your own"
            return f"has {lacking} {_moving(category)}: it has {', '.join(map(repr, controls))} instead; {cure}"
    return f"its joints do not form the tree of a {category.name}"


def _folded(assignment: _Assignment, category: Category) -> RawArticulation:
    raw, parts = assignment.raw, assignment.links
    # extra joints first move to where they may be, and all that they carry with them
    T = [np.eye(4)]
    for joint in raw.joints:
        extra = joint.child not in parts
        T.append(T[joint.parent] @ _at_allowed_zero(joint) if extra else T[joint.parent])
    carried: list[list[Mesh]] = [[] for _ in parts]
    for link, body in enumerate(raw.links):
        carried[parts.index(_carrier(raw, link, parts))].append(body.mesh.carried(T[link]))
    links = [replace(raw.links[link], mesh=_welded(merge_meshes(c))) for link, c in zip(parts, carried, strict=True)]
    joints = []
    for index, spec in enumerate(category.joints):
        joint = raw.joints[parts[index + 1] - 1]
        moved = T[joint.parent]
        axis, pivot = moved[:3, :3] @ joint.axis, carry(moved, joint.pivot)
        joints.append(replace(joint, parent=spec.parent, child=index + 1, axis=axis, pivot=pivot))
    return replace(raw, links=tuple(links), joints=tuple(joints))


def _at_allowed_zero(joint: RawJoint) -> np.ndarray:
    state = 0.0 if joint.limits is None else float(np.clip(0.0, *joint.limits))
    axis, pivot = (torch.as_tensor(value)[None, None] for value in (joint.axis, joint.pivot))
    states = torch.tensor([[state]], dtype=axis.dtype)
    return joint_transforms(KinematicTree((0,), (joint.motion,)), axis, pivot, states)[0, 0].numpy()


def _welded(mesh: Mesh) -> Mesh:
    """Vertices at the same place become one, as surfaces that close in space should close in the mesh."""
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[mesh.faces].reshape(-1, 3)
    a, b, c = faces.T
    return Mesh(vertices, faces[(a != b) & (b != c) & (c != a)])
