"""URDF of object models. The root link is canonical space and zero of every joint is the rest state."""

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from omad.common.files import write_text
from omad.geometry.joint_kinds import Motion, elementary, type_of
from omad.geometry.mesh import Mesh

from .model import ObjectModel

COUPLED = "_slide"
"""What the second of two joints that stand for one, and the empty link between them, are called besides its name."""

MESHES = "meshes"


def write_urdf(model: ObjectModel, path: Path | str) -> Path:
    """Write ``model`` to ``path`` (a ``.urdf`` file, or a folder: ``<folder>/model.urdf``) -> the file. Meshes go to
    ``meshes/`` beside the file, as OBJ. Each file is written whole or not at all, the URDF last."""
    path = Path(path)
    file = path if path.suffix.lower() == ".urdf" else path / "model.urdf"
    write_text(file, xml_text(urdf_robot(model, file)))
    return file


def urdf_robot(model: ObjectModel, file: Path, collisions: Sequence[Sequence[Mesh]] | None = None) -> Element:
    """What belongs into ``file``, whose meshes are written. ``collisions`` are the bodies of each part that simulators
    take; without, they take its mesh."""
    robot = Element("robot", name=model.name)
    # a joint that only slides has no place of its own: its frame stays at the canonical origin
    places = np.concatenate([np.zeros((1, 3)), model.pivots])
    files = mesh_files(model, file)
    for part, (name, mesh) in enumerate(zip(model.part_names, model.parts, strict=True)):
        shapes = [("visual", files[part], mesh)]
        if collisions is None:
            shapes.append(("collision", files[part], mesh))
        else:
            bodies = enumerate(collisions[part])
            shapes += [("collision", files[part].with_stem(f"{files[part].stem}-body-{n}"), body) for n, body in bodies]
        link = SubElement(robot, "link", name=name)
        for role, mesh_file, shape in shapes:
            _write_obj(shape, mesh_file)
            element = SubElement(link, role)
            SubElement(element, "origin", xyz=urdf_numbers(-places[part]), rpy="0 0 0")
            SubElement(SubElement(element, "geometry"), "mesh", filename=f"{MESHES}/{mesh_file.name}")
    for index, (name, parent) in enumerate(zip(model.joint_names, model.tree.parents, strict=True)):
        ends = [model.part_names[parent], model.part_names[index + 1]]
        offset, limits, motion = places[index + 1] - places[parent], model.limits[index], model.tree.motions[index]
        first, *second = elementary(motion)
        if second:  # an empty link between two joints, of which one mimics the other
            ends.insert(1, f"{name}{COUPLED}")
            SubElement(robot, "link", name=ends[1])
        _add_joint(robot, name, first, ends[:2], offset, model.axes[index], limits)
        for slide in second:
            travel = np.sort(motion.slide * limits)
            joint = _add_joint(robot, f"{name}{COUPLED}", slide, ends[1:], np.zeros(3), model.axes[index], travel)
            SubElement(joint, "mimic", joint=name, multiplier=repr(motion.slide), offset="0")
    return robot


def _write_obj(mesh: Mesh, path: Path) -> None:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    write_text(path, "\n".join([*lines, ""]))


def mesh_files(model: ObjectModel, file: Path) -> list[Path]:
    """Per part where ``write_urdf`` puts its mesh, beside the URDF ``file``."""
    stems = (f"{file.stem}-{part}-{name}" for part, name in enumerate(model.part_names))
    return [file.parent / MESHES / (re.sub(r"[^\w-]", "_", stem) + ".obj") for stem in stems]


def _add_joint(
    robot: Element, name: str, motion: Motion, ends: list[str], offset: np.ndarray, axis: np.ndarray, limits: np.ndarray
) -> Element:
    """A joint from the first of two links to the second, whose frame lies at ``offset`` (3,) from the first's."""
    joint = SubElement(robot, "joint", name=name, type=type_of(motion))
    SubElement(joint, "parent", link=ends[0])
    SubElement(joint, "child", link=ends[1])
    SubElement(joint, "origin", xyz=urdf_numbers(offset), rpy="0 0 0")
    SubElement(joint, "axis", xyz=urdf_numbers(axis))
    # effort and velocity mean nothing here, but strict parsers refuse a limit without them
    limit = {"lower": repr(float(limits[0])), "upper": repr(float(limits[1])), "effort": "100", "velocity": "10"}
    SubElement(joint, "limit", limit)
    return joint


def xml_text(robot: Element) -> str:
    """The whole file, indented."""
    indent(robot)
    return '<?xml version="1.0"?>\n' + tostring(robot, encoding="unicode") + "\n"


def urdf_numbers(values: np.ndarray) -> str:
    """As they stand in a URDF's attributes, with all their digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)
