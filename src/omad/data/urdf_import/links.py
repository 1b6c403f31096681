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
from omad.geometry.rigid import carry, diagonal
from omad.objects.category import Category

from .articulation import RawArticulation, RawJoint, RawLink
from .equivalent import rehung, with_screws

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


def label_parts(raw: RawArticulation, category: Category) -> list[RawArticulation]:
    """The articulation reduced to the category's parts, in their order; several where only geometry can order them.
    Other links are folded into the part that carries them, in the state nearest to zero that their joint allows. Raises
    InputError, without the file's name, where links and joints do not fit the category."""
    raw = with_screws(raw, category)
    if (
        ways := prod(perm(len(_links(raw, kind, category)), _wanted(category, kind)) for kind in JOINT_TYPES)
    ) > MOST_WAYS:
        raise InputError(f"its joints fit a {category.name} in {ways} ways; leave out those that are of none")
    roots = [0] + [link for link in range(1, len(raw.links)) if _named(raw.links[link], category, 0)]
    hung = [raw.rerooted(root) for root in roots]
    found = [assignment for each in hung for assignment in _assignments(each, category)]
    if not found:
        found = [a for each in hung for other in rehung(each) for a in _assignments(other, category)]
    if not found:
        raise InputError(_why_none(raw, category))
    most = max(a.named for a in found)
    found = [a for a in found if a.named == most]
    found = [a for a in found if a.raw is found[0].raw]  # the file's own root, if it may be
    best = max(found, key=lambda a: a.size)
    rivals = [a for a in found if set(a.links) != set(best.links) and _comparable(a, best)]
    if rivals:
        count, few = len(set(best.links[1:]).union(*(a.links[1:] for a in rivals))), len(best.links) - 1
        said = f"{count} links fit the part(s) {_moving(category)} equally well; {category.name} has {few}"
        raise InputError(f"{said}: leave it out, or give a category that has {count}")
    return [_folded(a, category) for a in found if set(a.links) == set(best.links)]


def _named(link: RawLink, category: Category, part: int) -> bool:
    return any(alias in " ".join(link.names).lower() for alias in category.parts[part].aliases)


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

    def extend(links: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        part = len(links)
        if part == len(category.parts):
            yield links
            return
        spec = category.joints[part - 1]
        for joint in raw.joints:
            fits = joint.type == spec.type and _may_be(raw.links[joint.child], category, part)
            if joint.child not in links and fits and _carrier(raw, joint.parent, links) == links[spec.parent]:
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
