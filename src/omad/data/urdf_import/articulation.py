"""URDF as other people write it, read as it is."""

import io
import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import yourdfpy

from omad.common.errors import InputError, shown
from omad.common.incoming import existing, read_bytes, readable
from omad.common.limits import check_limit
from omad.geometry.joint_kinds import JointType, Motion, motion_of, type_of
from omad.geometry.mesh import Mesh, merge_meshes
from omad.geometry.rigid import rigid
from omad.objects.category import Category
from omad.objects.model import ObjectModel

from .shapes import MeshFiles, MissingMeshes, link_mesh

SHAPES = {"mesh", "box", "cylinder", "sphere"}
FARTHEST = 1e6
"""Nothing in a URDF is farther away, in its own unit."""
REPAIR = "repair the file or download it again"
XACRO = re.compile(r"\$[{(]")
"""Where a value has yet to be worked out."""
_JOINT_TYPES: dict[str, JointType] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
"""URDF's own names."""
_FREE = {"floating", "planar"}
"""Those of joints by which a whole object moves in the world."""


@dataclass(frozen=True)
class RawLink:
    """One rigid body: a link together with all that is fixed to it."""

    name: str
    """The link's own name; of several fixed together, that of the first with a mesh."""
    names: tuple[str, ...]
    """Names of all links with meshes in this body."""
    mesh: Mesh
    """Metres, model frame at zero configuration; empty where no link has geometry."""


@dataclass(frozen=True)
class RawJoint:
    """A movable joint, in the model frame at zero configuration."""

    name: str
    motion: Motion
    """Metres and radians."""
    parent: int
    """Index of a link."""
    child: int
    axis: np.ndarray
    """(3,) unit."""
    pivot: np.ndarray
    """(3,) metres: the joint frame's origin."""
    limits: tuple[float, float] | None
    """Radians or metres; None where the file states none, or an infinite one."""
    follows: str | None = None
    """The joint that the file lets it move with (``mimic``)."""
    inverted: bool = False
    """The file states its lower limit above the upper one."""

    @property
    def type(self) -> JointType:
        return type_of(self.motion)

    def turned(self) -> Self:
        """The same joint with its parent and its child exchanged."""
        return replace(self, parent=self.child, child=self.parent, axis=-self.axis)


@dataclass(frozen=True)
class RawArticulation:
    """What a URDF says, in the frame of its root link; root first, parents before children."""

    name: str
    links: tuple[RawLink, ...]
    joints: tuple[RawJoint, ...]
    """In the order of their children: the child of ``joints[i]`` is ``links[i + 1]``."""
    skipped: tuple[str, ...] = ()
    """Meshes that the file names and that are missing."""
    empty: tuple[str, ...] = ()
    """Those without a triangle."""

    def rerooted(self, root: int) -> Self:
        """The same articulation hung up at link ``root``: joints on the way to the old root are turned round."""
        both = [each for joint in self.joints for each in (joint, joint.turned())]
        order, joints = [root], list[RawJoint]()
        for link in order:
            for joint in both:
                if joint.parent == link and joint.child not in order:
                    order.append(joint.child)
                    joints.append(joint)
        return self.with_links(order, joints)

    def with_links(self, links: Sequence[int], joints: Iterable[RawJoint]) -> Self:
        """The same articulation of these links alone, in this order, with joints between them."""
        place = {link: index for index, link in enumerate(links)}
        kept = tuple(replace(joint, parent=place[joint.parent], child=place[joint.child]) for joint in joints)
        return replace(self, links=tuple(self.links[link] for link in links), joints=kept)


@dataclass(frozen=True)
class _Slide:
    """Of a joint that slides as another one turns."""

    turn: str
    """The other one's name."""
    per_radian: float
    """How far it slides along the other one's axis, in the file's unit."""
    start: float
    """Where it is along its own axis when the other one is at zero."""
    turns: tuple[float, float] | None
    """Between which states of the other one, radians, its own limits keep it; None where the file states none."""


def read_articulation(
    path: Path | str,
    metres_per_unit: float = 1.0,
    missing_meshes: MissingMeshes = "refuse",
    mesh_folder: Path | None = None,
) -> RawArticulation:
    """Read a URDF with its visual meshes (a link without any: its collision meshes).

    Continuous joints become hinges without limits; what is joined by fixed joints becomes one link;
    links without geometry at the root or at the tips are dropped. ``metres_per_unit`` scales all lengths.
    Mesh files lie beside the URDF, in its ROS package, or in ``mesh_folder``: others are not opened.
    Raises InputError for a file that is missing, broken or no tree, a missing mesh, an unknown joint type.
    """
    path = existing(path, "a URDF")
    with readable(path, "a URDF", REPAIR):
        return _articulation(path, metres_per_unit, MeshFiles(path, missing_meshes, mesh_folder))


def _articulation(path: Path, metres_per_unit: float, files: MeshFiles) -> RawArticulation:
    robot = _parse(path)
    root, joints = _sorted_tree(path, robot)
    T_model = _places(root, joints)
    coupled = _coupled(robot, joints, T_model)
    T_model = _places(root, joints, coupled)
    for name, T in T_model.items():
        if not (np.abs(T) < FARTHEST).all():
            raise InputError(f"{path}: link {name!r} has no proper origin; give finite numbers, not so large")

    body_of, members, moving = {root: 0}, [[root]], []
    for joint in joints:
        if joint.type == "fixed" or joint.name in coupled:
            body_of[joint.child] = body_of[joint.parent]
            members[body_of[joint.child]].append(joint.child)
        else:
            body_of[joint.child] = len(members)
            members.append([joint.child])
            moving.append(joint)

    links, bodies = {link.name: link for link in robot.links}, []
    for names in members:
        parts = {name: link_mesh(links[name], T_model[name], files) for name in names}
        solid = tuple(name for name in names if len(parts[name].faces))
        mesh = merge_meshes(parts.values()).warped(lambda vertices: vertices * metres_per_unit)
        bodies.append(RawLink((solid or names)[0], solid, mesh))
    slides = {slide.turn: slide for slide in coupled.values()}
    raw = []
    for joint in moving:
        ends, slide = (body_of[joint.parent], body_of[joint.child]), slides.get(joint.name)
        raw.append(_raw_joint(path, joint, slide, ends, T_model[joint.child], metres_per_unit))
    found = RawArticulation(
        robot.name or path.stem, tuple(bodies), tuple(raw), tuple(files.skipped), tuple(files.empty)
    )
    return _without_empty_ends(path, found)


def read_urdf(path: Path | str, category: Category) -> ObjectModel:
    """Read a file of ``write_urdf`` back, exactly. Other people's files: ``omad.data.urdf_import.folder.import_model``.
    Raises InputError where its links and joints are not the category's."""
    raw = read_articulation(path)
    names, wanted = [link.name for link in raw.links], [part.name for part in category.parts]
    if sorted(names) != sorted(wanted):
        unlike = f"links {', '.join(names)} are not the parts of a {category.name} ({', '.join(wanted)})"
        raise InputError(f"{path}: {unlike}; import it with omad.data.urdf_import.folder.import_model")
    joint_to = {names[joint.child]: joint for joint in raw.joints}
    joints = tuple(joint_to[name] for name in wanted[1:] if name in joint_to)
    found = [(joint.type, names[joint.parent]) for joint in joints]
    if found != [(spec.type, wanted[spec.parent]) for spec in category.joints]:
        raise InputError(f"{path}: its joints are not those of a {category.name}; import it as a foreign model")
    for joint in joints:
        if joint.limits is None:
            raise InputError(f"{path}: joint {joint.name!r} has no limits; import it as a foreign model")
    parts = tuple(raw.links[names.index(name)] for name in wanted)
    model = as_model(replace(raw, links=parts, joints=joints), category)
    pivots = np.where(np.array(model.tree.turning)[:, None], model.pivots, 0.0)
    return replace(model, pivots=pivots)


def as_model(raw: RawArticulation, category: Category) -> ObjectModel:
    """Links and joints that are the category's, in its order, as they stand, joints by their own names; limits that are
    not stated are NaN."""
    model = ObjectModel.of(
        category,
        raw.name,
        parts=[link.mesh for link in raw.links],
        axes=np.stack([joint.axis for joint in raw.joints]),
        pivots=np.stack([joint.pivot for joint in raw.joints]),
        limits=np.array([joint.limits or (np.nan, np.nan) for joint in raw.joints], dtype=np.float64),
        motions=[joint.motion for joint in raw.joints],
    )
    return replace(model, joint_names=tuple(joint.name for joint in raw.joints))


def _parse(path: Path) -> Any:
    content = read_bytes(path, "text_bytes")
    if b"<!" in content.replace(b"<!--", b""):  # entities could name other files, or grow without end
        raise InputError(f"{shown(path)}: declares entities (<!DOCTYPE ...), which no URDF needs; remove them")
    try:
        # yourdfpy would go on with the readable half of a broken file
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        if error.position == (1, 0):  # an image, an archive, or nothing at all
            raise InputError(f"{shown(path)}: is no URDF, nor a folder; give a URDF, or a folder") from error
        raise InputError(f"{shown(path)}: broken XML ({error}); {REPAIR}") from error
    if any("/xacro}" in each.tag or XACRO.search(" ".join(each.attrib.values())) for each in root.iter()):
        raise InputError(f"{shown(path)}: is a xacro file; run xacro on it, and give the URDF that it writes")
    if root.tag != "robot":
        raise InputError(f"{shown(path)}: not a URDF: its root element is not <robot>")
    for kind in ("link", "joint"):
        check_limit("links", len(root.findall(kind)), f"{shown(path)}: the number of {kind}s")
    root.attrib.setdefault("name", "")
    for link in root.findall("link"):
        unseen = link.findall("collision") if link.find("visual") is not None else []
        for collision in unseen:  # of any shapes: they are not looked at
            link.remove(collision)
        for element in (*link.findall("visual"), *link.findall("collision")):
            shapes = [one.tag for one in element.findall("geometry/*")]
            if not shapes or not SHAPES.issuperset(shapes):
                said = ", ".join(map(shown, shapes)) or "none at all"
                what = f"link {link.get('name')!r} has a geometry of no known shape, {said}"
                raise InputError(f"{shown(path)}: {what}; give a mesh, box, cylinder or sphere")
    # as UTF-8, whatever encoding it was in
    text = io.BytesIO(ElementTree.tostring(root, encoding="utf-8"))
    return yourdfpy.URDF.load(text, build_scene_graph=False, load_meshes=False).robot


def _sorted_tree(path: Path, robot: Any) -> tuple[str, list[Any]]:
    """Root link and joints, parents before children and otherwise as in the file."""
    links = [link.name for link in robot.links]
    for kind, names in (("link", links), ("joint", [joint.name for joint in robot.joints])):
        for name, count in Counter(names).items():
            if count > 1:
                raise InputError(f"{path}: two {kind}s are called {name!r}; rename one")
    for names in (links, [name for joint in robot.joints for name in (joint.name, joint.parent, joint.child)]):
        if not all(isinstance(name, str) for name in names):
            raise InputError(f"{path}: a link or a joint has no name; give it one")
    if not links:
        raise InputError(f"{path}: no links; give a URDF with at least one")
    beyond = {*links} - {joint.child for joint in robot.joints} - _solid(robot)
    for joint in robot.joints:
        if joint.type in _FREE and joint.parent in beyond:
            joint.type = "fixed"
        if joint.type != "fixed" and joint.type not in _JOINT_TYPES:
            cure = f"give {', '.join(_JOINT_TYPES)}, or fixed, as where the object hangs on the world by it"
            raise InputError(f"{path}: joint {joint.name!r} has the type {joint.type!r}; {cure}")
        for end in (joint.parent, joint.child):
            if end not in links:
                raise InputError(f"{path}: joint {joint.name!r} names the link {end!r}, which is not in the file")
    parents = Counter(joint.child for joint in robot.joints)
    for child, count in parents.items():
        if count > 1:
            raise InputError(f"{path}: link {child!r} has {count} parents; a tree of links allows one")
    roots = [link for link in links if not parents[link]]
    if len(roots) > 1:
        raise InputError(f"{path}: links {', '.join(roots)} have no parent; join them to one root with fixed joints")
    order, joints = roots[:], []
    for link in order:
        following = [joint for joint in robot.joints if joint.parent == link]
        order += [joint.child for joint in following]
        joints += following
    if len(order) < len(links):
        loop = next(link for link in links if link not in order)
        raise InputError(f"{path}: the joints form a cycle through the link {loop!r}; remove one of them")
    return roots[0], joints


def _solid(robot: Any) -> set[str]:
    """Names of links with shapes."""
    return {link.name for link in robot.links if link.visuals or link.collisions}


def _places(root: str, joints: list[Any], coupled: "dict[str, _Slide] | None" = None) -> dict[str, np.ndarray]:
    """T_model_link (4, 4) of links, all joints at zero, those that are ``coupled`` where the others' zero has them."""
    T_model = {root: np.eye(4)}
    for joint in joints:
        T = T_model[joint.parent] @ (np.eye(4) if joint.origin is None else joint.origin)
        if (slide := (coupled or {}).get(joint.name)) is not None:
            T = T @ rigid(np.eye(3), slide.start * joint.axis / np.linalg.norm(joint.axis))
        T_model[joint.child] = T
    return T_model


def _coupled(robot: Any, joints: list[Any], T_model: dict[str, np.ndarray]) -> dict[str, "_Slide"]:
    """Sliding joints next to a turning one about the same axis, with only an empty link between, of which one mimics
    the other: the two are one joint. By the name of the slide."""
    before = {joint.child: joint for joint in joints}
    solid, found = _solid(robot), {}
    for joint in joints:
        first = before.get(joint.parent)
        if first is None or joint.parent in solid or not {first.type, joint.type} <= {*_JOINT_TYPES}:
            continue
        turn, slide = sorted((first, joint), key=lambda each: _JOINT_TYPES[each.type] == "prismatic")
        follower, leader = (slide, turn) if slide.mimic is not None else (turn, slide)
        along, other = (T_model[each.child][:3, :3] @ each.axis for each in (slide, turn))
        kinds = [_JOINT_TYPES[each.type] for each in (turn, slide)]
        if kinds != ["revolute", "prismatic"] or follower.mimic is None or follower.mimic.joint != leader.name:
            continue
        multiplier = 1.0 if follower.mimic.multiplier is None else float(follower.mimic.multiplier)
        offset = float(follower.mimic.offset or 0.0)
        if multiplier and np.allclose(np.cross(along, other), 0, atol=1e-6):
            ratio, start = (multiplier, offset) if follower is slide else (1 / multiplier, -offset / multiplier)
            ends = [slide.limit and slide.limit.lower, slide.limit and slide.limit.upper]
            low, high = sorted(((end or 0.0) - start) / ratio for end in ends)
            turns = None if ends == [None, None] else (low, high)
            found[slide.name] = _Slide(turn.name, ratio * float(np.sign(along @ other)), start, turns)
    return found


def _raw_joint(
    path: Path, joint: Any, slide: _Slide | None, ends: tuple[int, int], T: np.ndarray, unit: float
) -> RawJoint:
    """``T`` (4, 4) joint frame -> model; ``unit`` in metres; ``slide``: what is one with it."""
    if np.shape(joint.axis) != (3,):
        raise InputError(f"{path}: the axis of joint {joint.name!r} is no direction; give three numbers")
    axis = T[:3, :3] @ joint.axis
    length = np.linalg.norm(axis)
    motion = motion_of(_JOINT_TYPES[joint.type])
    if slide is not None:
        motion = Motion(motion.turn, slide.per_radian).scaled(unit)
    if not 0 < length < np.inf or (slide is not None and abs(slide.per_radian) > FARTHEST):
        raise InputError(
            f"{path}: joint {joint.name!r} has no proper origin and axis; give numbers, and an axis of some length"
        )
    limits, inverted = slide and slide.turns, False
    stated = [] if joint.limit is None else [joint.limit.lower, joint.limit.upper]
    if joint.type != "continuous" and any(limit is not None for limit in stated):
        given = [(limit or 0.0) * motion.state_unit(unit) for limit in stated]  # 0 is URDF's default
        (low, high), inverted = sorted(given), given[0] > given[1]
        if np.isnan([low, high]).any():
            raise InputError(f"{path}: the limits of joint {joint.name!r} are no numbers; leave them out")
        if max(-low, high) <= FARTHEST * unit:  # beyond, programs mean that there is none
            limits = low, high
    follows = None if joint.mimic is None or slide is not None else joint.mimic.joint
    return RawJoint(joint.name, motion, *ends, axis / length, T[:3, 3] * unit, limits, follows, inverted)


def _without_empty_ends(path: Path, raw: RawArticulation) -> RawArticulation:
    """Drop links without geometry that carry at most one joint: frames, and a 'world' the object hangs on."""
    links, joints = list(range(len(raw.links))), list(raw.joints)
    if not any(len(link.mesh.faces) for link in raw.links):
        raise InputError(f"{path}: no link has a mesh; give the file together with its meshes")
    while True:
        degree = Counter(end for joint in joints for end in (joint.parent, joint.child))
        empty = [link for link in links if not len(raw.links[link].mesh.faces) and degree[link] <= 1]
        if not empty:
            break
        links.remove(empty[0])
        joints = [joint for joint in joints if empty[0] not in (joint.parent, joint.child)]
    return raw.with_links(links, joints)
