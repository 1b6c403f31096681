"""URDF in and out.

``read_articulation`` reads any URDF as it is, ``write_urdf`` and ``read_urdf`` carry our own object
models. The written root link is canonical space and zero of every joint is the rest state.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh
import yourdfpy

from .categories import Category
from .errors import InputError
from .files import write_atomic
from .kinematics import JointType
from .objects import Mesh, ObjectModel

MissingMeshes = Literal["refuse", "skip"]
"""What to do about mesh files that a URDF names and that are not there."""

_JOINT_TYPES: dict[str, JointType] = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}


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
    type: JointType
    parent: int
    """Index of a link."""
    child: int
    axis: np.ndarray
    """(3,) unit."""
    pivot: np.ndarray
    """(3,) metres: the joint frame's origin."""
    limits: tuple[float, float] | None
    """Radians or metres; None where the file states none."""


@dataclass(frozen=True)
class RawArticulation:
    """What a URDF says, in the frame of its root link; root first, parents before children."""

    name: str
    links: tuple[RawLink, ...]
    joints: tuple[RawJoint, ...]
    """In the order of their children: the child of ``joints[i]`` is ``links[i + 1]``."""

    def rerooted(self, root: int) -> RawArticulation:
        """The same articulation hung up at link ``root``: joints on the way to the old root are turned round."""
        neighbours: list[tuple[int, int, RawJoint]] = []
        for joint in self.joints:
            turned = replace(joint, parent=joint.child, child=joint.parent, axis=-joint.axis)
            neighbours += [(joint.parent, joint.child, joint), (joint.child, joint.parent, turned)]
        order, joints = [root], list[RawJoint]()
        for link in order:
            for start, end, joint in neighbours:
                if start == link and end not in order:
                    order.append(end)
                    joints.append(joint)
        place = {link: index for index, link in enumerate(order)}
        return replace(
            self,
            links=tuple(self.links[link] for link in order),
            joints=tuple(replace(j, parent=place[j.parent], child=place[j.child]) for j in joints),
        )


def read_articulation(
    path: Path | str, metres_per_unit: float = 1.0, missing_meshes: MissingMeshes = "refuse"
) -> RawArticulation:
    """Read a URDF with its visual meshes (a link without any: its collision meshes).

    Continuous joints become revolute ones without limits; what is joined by fixed joints becomes one link;
    links without geometry at the root or at the tips are dropped. ``metres_per_unit`` scales all lengths.
    Raises InputError for a file that is missing, broken or no tree, a missing mesh, an unknown joint type.
    """
    path = Path(path)
    robot = _parse(path)
    root, joints = _sorted_tree(path, robot)
    T_model = {root: np.eye(4)}
    for joint in joints:
        T_model[joint.child] = T_model[joint.parent] @ _origin(joint)

    loader = _MeshLoader(path, missing_meshes)
    body_of, members = {root: 0}, [[root]]
    moving = []
    for joint in joints:
        if joint.type == "fixed":
            body_of[joint.child] = body_of[joint.parent]
            members[body_of[joint.child]].append(joint.child)
        else:
            body_of[joint.child] = len(members)
            members.append([joint.child])
            moving.append(joint)

    links = {link.name: link for link in robot.links}
    bodies = []
    for names in members:
        parts = {name: loader.link(links[name], T_model[name]) for name in names}
        solid = tuple(name for name in names if len(parts[name].faces))
        mesh = merge_meshes(list(parts.values()))
        bodies.append(RawLink(solid[0] if solid else names[0], solid, _scaled(mesh, metres_per_unit)))
    raw = [_raw_joint(path, joint, body_of, T_model[joint.child], metres_per_unit) for joint in moving]
    return _without_empty_ends(path, RawArticulation(robot.name or path.stem, tuple(bodies), tuple(raw)))


def read_urdf(path: Path | str, category: Category) -> ObjectModel:
    """Read a file of ``write_urdf`` back, exactly. Other people's files: ``omad.sources.folder.import_model``.

    Raises InputError where its links and joints are not the category's.
    """
    raw = read_articulation(path)
    names = [link.name for link in raw.links]
    wanted = [part.name for part in category.parts]
    if sorted(names) != sorted(wanted):
        raise InputError(
            f"{path}: links {', '.join(names)} are not the parts of a {category.name} ({', '.join(wanted)}); "
            "import it with omad.sources.folder.import_model"
        )
    joint_to = {names[joint.child]: joint for joint in raw.joints}
    joints = [joint_to[name] for name in wanted[1:] if name in joint_to]
    found = [(joint.type, names[joint.parent]) for joint in joints]
    if found != [(spec.type, wanted[spec.parent]) for spec in category.joints]:
        raise InputError(f"{path}: its joints are not those of a {category.name}; import it as a foreign model")
    unlimited = [joint.name for joint in joints if joint.limits is None]
    if unlimited:
        raise InputError(f"{path}: joint {unlimited[0]!r} has no limits; import it as a foreign model")
    return ObjectModel(
        name=raw.name,
        category=category.name,
        part_names=tuple(wanted),
        parts=tuple(raw.links[names.index(name)].mesh for name in wanted),
        joint_names=tuple(joint.name for joint in joints),
        tree=category.tree,
        axes=np.stack([joint.axis for joint in joints]),
        pivots=np.stack([joint.pivot if joint.type == "revolute" else np.zeros(3) for joint in joints]),
        limits=np.array([joint.limits for joint in joints], dtype=np.float64),
    )


def write_urdf(model: ObjectModel, path: Path | str) -> Path:
    """Write ``model`` to ``path`` (a ``.urdf`` file, or a folder: ``<folder>/model.urdf``) -> the file.

    Meshes go to ``meshes/`` beside the file, as OBJ. Each file is written whole or not at all, the URDF last.
    """
    path = Path(path)
    file = path if path.suffix == ".urdf" else path / "model.urdf"

    robot = ElementTree.Element("robot", name=model.name)
    # a prismatic joint has no place of its own: its frame stays at the canonical origin
    places = np.concatenate([np.zeros((1, 3)), model.pivots])
    for part, (name, mesh) in enumerate(zip(model.part_names, model.parts, strict=True)):
        mesh_file = Path("meshes") / (re.sub(r"[^\w-]", "_", f"{file.stem}-{part}-{name}") + ".obj")
        _write_text(file.parent / mesh_file, _obj_text(mesh))
        link = ElementTree.SubElement(robot, "link", name=name)
        for role in ("visual", "collision"):
            element = ElementTree.SubElement(link, role)
            ElementTree.SubElement(element, "origin", xyz=_numbers(-places[part]), rpy="0 0 0")
            geometry = ElementTree.SubElement(element, "geometry")
            ElementTree.SubElement(geometry, "mesh", filename=mesh_file.as_posix())
    for index, (name, parent) in enumerate(zip(model.joint_names, model.tree.parents, strict=True)):
        joint = ElementTree.SubElement(robot, "joint", name=name, type=model.tree.types[index])
        ElementTree.SubElement(joint, "parent", link=model.part_names[parent])
        ElementTree.SubElement(joint, "child", link=model.part_names[index + 1])
        ElementTree.SubElement(joint, "origin", xyz=_numbers(places[index + 1] - places[parent]), rpy="0 0 0")
        ElementTree.SubElement(joint, "axis", xyz=_numbers(model.axes[index]))
        low, high = model.limits[index]
        # effort and velocity mean nothing here, but strict parsers refuse a limit without them
        limit = {"lower": repr(float(low)), "upper": repr(float(high)), "effort": "100", "velocity": "10"}
        ElementTree.SubElement(joint, "limit", limit)
    ElementTree.indent(robot)
    _write_text(file, '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n")
    return file


def merge_meshes(meshes: list[Mesh]) -> Mesh:
    """One mesh of several, in their order."""
    start = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return Mesh(
        np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in meshes)]),
        np.concatenate(
            [np.zeros((0, 3), np.int64), *(mesh.faces + n for mesh, n in zip(meshes, start[:-1], strict=True))]
        ),
    )


def _scaled(mesh: Mesh, factor: float) -> Mesh:
    return Mesh(mesh.vertices * factor, mesh.faces)


def _parse(path: Path) -> Any:
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a URDF")
    try:
        # yourdfpy would go on with the readable half of a broken file
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: broken XML ({error}); repair the file or download it again") from error
    if root.tag != "robot":
        raise InputError(f"{path}: not a URDF: its root element is <{root.tag}>, expected <robot>")
    try:
        return yourdfpy.URDF.load(str(path), build_scene_graph=False, load_meshes=False).robot
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: cannot be read as a URDF ({reason}); repair the file") from error


def _sorted_tree(path: Path, robot: Any) -> tuple[str, list[Any]]:
    """Root link and joints, parents before children and otherwise as in the file."""
    links = [link.name for link in robot.links]
    for kind, names in (("link", links), ("joint", [joint.name for joint in robot.joints])):
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise InputError(f"{path}: two {kind}s are called {twice[0]!r}; rename one")
    if not links:
        raise InputError(f"{path}: no links; give a URDF with at least one")
    for joint in robot.joints:
        if joint.type != "fixed" and joint.type not in _JOINT_TYPES:
            known = ", ".join([*_JOINT_TYPES, "fixed"])
            raise InputError(f"{path}: joint {joint.name!r} has the type {joint.type!r}; supported are {known}")
        for end in (joint.parent, joint.child):
            if end not in links:
                raise InputError(f"{path}: joint {joint.name!r} names the link {end!r}, which is not in the file")
    for child, count in Counter(joint.child for joint in robot.joints).items():
        if count > 1:
            raise InputError(f"{path}: link {child!r} has {count} parents; a tree of links allows one")
    children = {joint.child for joint in robot.joints}
    roots = [link for link in links if link not in children]
    if len(roots) > 1:
        raise InputError(f"{path}: links {', '.join(roots)} have no parent; join them to one root with fixed joints")
    order = roots[:]
    joints = []
    for link in order:
        following = [joint for joint in robot.joints if joint.parent == link]
        order += [joint.child for joint in following]
        joints += following
    if len(order) < len(links):
        loop = next(link for link in links if link not in order)
        raise InputError(f"{path}: the joints form a cycle through the link {loop!r}; remove one of them")
    return roots[0], joints


def _origin(joint: Any) -> np.ndarray:
    return np.eye(4) if joint.origin is None else joint.origin


def _raw_joint(path: Path, joint: Any, body_of: dict[str, int], T: np.ndarray, metres_per_unit: float) -> RawJoint:
    axis = T[:3, :3] @ joint.axis
    length = np.linalg.norm(axis)
    kind = _JOINT_TYPES[joint.type]
    if not np.isfinite(T).all() or not np.isfinite(length) or length == 0:
        raise InputError(f"{path}: joint {joint.name!r} has no proper origin and axis; give finite numbers")
    limits = None
    if joint.type != "continuous" and joint.limit is not None and None not in (joint.limit.lower, joint.limit.upper):
        unit = metres_per_unit if kind == "prismatic" else 1.0
        low, high = sorted((joint.limit.lower * unit, joint.limit.upper * unit))
        if not np.isfinite([low, high]).all():
            raise InputError(f"{path}: the limits of joint {joint.name!r} are not finite; use a continuous joint")
        limits = (low, high)
    pivot = T[:3, 3] * metres_per_unit
    return RawJoint(joint.name, kind, body_of[joint.parent], body_of[joint.child], axis / length, pivot, limits)


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
    place = {link: index for index, link in enumerate(links)}
    kept = tuple(replace(joint, parent=place[joint.parent], child=place[joint.child]) for joint in joints)
    return replace(raw, links=tuple(raw.links[link] for link in links), joints=kept)


@dataclass(frozen=True)
class _MeshLoader:
    path: Path
    missing: MissingMeshes

    def link(self, link: Any, T_model_link: np.ndarray) -> Mesh:
        meshes = []
        for element in link.visuals or link.collisions:
            mesh = self._geometry(link.name, element.geometry)
            if mesh is not None:
                T = T_model_link if element.origin is None else T_model_link @ element.origin
                meshes.append(Mesh(mesh.vertices @ T[:3, :3].T + T[:3, 3], mesh.faces))
        return merge_meshes(meshes)

    def _geometry(self, link: str, geometry: Any) -> Mesh | None:
        makers: list[tuple[Any, Callable[[Any], trimesh.Trimesh]]] = [
            (geometry.box, lambda box: trimesh.creation.box(extents=box.size)),
            (geometry.cylinder, lambda c: trimesh.creation.cylinder(radius=c.radius, height=c.length)),
            (geometry.sphere, lambda sphere: trimesh.creation.icosphere(subdivisions=3, radius=sphere.radius)),
        ]
        for shape, make in makers:
            if shape is not None:
                solid = make(shape)
                return Mesh(np.asarray(solid.vertices, np.float64), np.asarray(solid.faces, np.int64))
        file = self._find(geometry.mesh.filename or "")
        if file is None:
            if self.missing == "skip":
                return None
            raise InputError(
                f"{self.path}: mesh {geometry.mesh.filename!r} of link {link!r} is missing; "
                "restore it, or read with missing_meshes='skip'"
            )
        scale = np.ones(3) if geometry.mesh.scale is None else np.asarray(geometry.mesh.scale, np.float64)
        mesh = _load_mesh(file)
        faces = mesh.faces[:, ::-1] if np.prod(np.broadcast_to(scale, 3)) < 0 else mesh.faces
        return Mesh(mesh.vertices * scale, faces)

    def _find(self, filename: str) -> Path | None:
        """The file beside the URDF or in a folder above it, with or without its package's name."""
        name = Path(re.sub(r"^(package|file)://", "", filename))
        names = [name, Path(*name.parts[1:])] if filename.startswith("package://") else [name]
        folder = self.path.resolve().parent
        places = [place / name for place in (folder, *folder.parents) for name in names]
        return next((place for place in places if filename and place.is_file()), None)


def _load_mesh(file: Path) -> Mesh:
    try:
        if file.suffix.lower() == ".obj":
            vertices, faces = _parse_obj(file.read_text(encoding="utf-8", errors="replace"))
        else:
            loaded: Any = trimesh.load(str(file), force="mesh", process=False)
            vertices, faces = np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64)
        vertices, faces = vertices.reshape(-1, 3), faces.reshape(-1, 3)
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise ValueError("a face names a vertex that is not there")
    except Exception as error:
        raise InputError(f"{file}: cannot be read as a mesh ({error}); export it again") from error
    if not np.isfinite(vertices).all():
        raise InputError(f"{file}: has vertices that are not finite; export it again")
    return Mesh(vertices, faces)


def _parse_obj(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions and triangles alone, in the file's order: texture coordinates and normals would split vertices."""
    vertices, faces = list[list[float]](), list[tuple[int, int, int]]()
    for line in text.replace("\\\n", " ").splitlines():
        kind, *fields = line.split() or [""]
        if kind == "v":
            vertices.append([float(field) for field in fields[:3]])
        elif kind == "f":
            corners = [int(field.split("/")[0]) for field in fields]
            corners = [c - 1 if c > 0 else len(vertices) + c for c in corners]
            faces += [(corners[0], b, c) for b, c in zip(corners[1:-1], corners[2:], strict=True)]
    return np.array(vertices, np.float64), np.array(faces, np.int64)


def _numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)


def _obj_text(mesh: Mesh) -> str:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    return "\n".join(lines) + "\n"


def _write_text(path: Path, text: str) -> None:
    write_atomic(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
