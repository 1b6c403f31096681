"""URDF for simulators: rooted in the camera's or the world's frame, with masses, and the estimated state beside it."""

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from scipy.spatial.transform import Rotation

from omad.common.files import write_json, write_text
from omad.objects.urdf import urdf_numbers, urdf_robot, xml_text

from .robot import Robot, Solid


def save_robot(robot: Robot, path: str | Path) -> None:
    """Write ``path`` (.urdf), meshes beside it and ``<stem>-joints.json``, ``{joint name: state}``. The root link is
    ``robot.root``'s, a fixed joint puts the object where it was seen. Zero is the rest state, as limits refer to it:
    set the joints from the JSON file to see the estimate."""
    path, model = Path(path), robot.model
    root = urdf_robot(model, path, robot.bodies)
    solids = dict(zip(model.part_names, robot.solids, strict=True))
    for link in root.findall("link"):
        link.insert(0, _inertial(solids.get(link.get("name", "")) or Solid.of(None)))
    held = dict(zip(model.joint_names, zip(robot.damping, robot.friction, strict=True), strict=True))
    for joint in root.findall("joint"):
        if (forces := held.get(joint.get("name", ""))) is not None:
            SubElement(joint, "dynamics", damping=repr(float(forces[0])), friction=repr(float(forces[1])))
    root.insert(0, Element("link", name=robot.root.name))
    fixed = SubElement(root, "joint", name=f"{robot.root.name}_to_{model.part_names[0]}", type="fixed")
    SubElement(fixed, "parent", link=robot.root.name)
    SubElement(fixed, "child", link=model.part_names[0])
    T = robot.T_root_link[0]
    angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz")
    SubElement(fixed, "origin", xyz=urdf_numbers(T[:3, 3]), rpy=urdf_numbers(angles))
    write_text(path, xml_text(root))
    states = dict(zip(model.joint_names, robot.states.tolist(), strict=True))
    write_json(path.with_name(f"{path.stem}-joints.json"), states, indent=1)


def _inertial(solid: Solid) -> Element:
    element = Element("inertial")
    SubElement(element, "origin", xyz=urdf_numbers(solid.centre), rpy="0 0 0")
    SubElement(element, "mass", value=repr(solid.mass))
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    SubElement(element, "inertia", {name: repr(float(solid.inertia[place])) for name, place in places.items()})
    return element
