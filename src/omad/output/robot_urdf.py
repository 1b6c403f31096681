"""URDF for simulators: rooted in the camera frame, with masses, and the estimated state beside it."""

from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, parse

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from omad.common.files import write_json, write_text
from omad.estimation.estimate import Estimate
from omad.geometry.mesh import merge_meshes
from omad.geometry.rigid import carry_each
from omad.objects.urdf import urdf_numbers, write_urdf, xml_text
from omad.sensing.observation import Observation

from .collision import collision_bodies
from .ply import part_surfaces

CAMERA = "camera_optical_frame"
EMPTY = 0.02
"""Metres: sides of the box whose mass a link without a body has."""
DENSITY = 300.0
"""kg per cubic metre of a part's bodies; a guess, a depth image shows no mass."""


def link_frames(estimate: Estimate) -> np.ndarray:
    """(K, 4, 4) camera frame: where the URDF's links are at the estimated state. A link's frame stands at its joint's
    pivot; that of the base and of joints that only slide at the canonical origin."""
    frames = estimate.T_camera_part.copy()
    frames[:, :3, 3] = carry_each(frames, np.concatenate([np.zeros((1, 3)), estimate.canonical_pivots]))
    return frames


def save_robot(estimate: Estimate, path: str | Path, observation: Observation | None = None) -> None:
    """Write ``path`` (.urdf), meshes beside it and ``<stem>-joints.json``, ``{joint name: state}``. The root link is
    ``camera_optical_frame``, a fixed joint puts the object where it was seen. Zero is the rest state, as limits refer
    to it: set the joints from the JSON file to see the estimate."""
    path = Path(path)
    model = replace(estimate.object_model(path.stem), parts=tuple(part_surfaces(estimate, observation)))
    bodies = [[body.mesh for body in of_part] for of_part in collision_bodies(model)]
    write_urdf(model, path, bodies)
    robot = parse(path).getroot()
    places = np.concatenate([np.zeros((1, 3)), model.pivots])
    merged = [merge_meshes(of_part) for of_part in bodies]
    solids = {
        name: trimesh.Trimesh(mesh.vertices - place, mesh.faces, process=False)
        for name, mesh, place in zip(model.part_names, merged, places, strict=True)
        if len(mesh.faces)
    }
    empty = trimesh.creation.box(extents=[EMPTY] * 3)  # a link between two joints for one: simulators need some mass
    for link in robot.findall("link"):
        link.insert(0, _inertial(solids.get(link.get("name", ""), empty)))
    robot.insert(0, Element("link", name=CAMERA))
    fixed = SubElement(robot, "joint", name=f"{CAMERA}_to_{model.part_names[0]}", type="fixed")
    SubElement(fixed, "parent", link=CAMERA)
    SubElement(fixed, "child", link=model.part_names[0])
    xyz, angles = estimate.T_camera_base[:3, 3], Rotation.from_matrix(estimate.T_camera_base[:3, :3]).as_euler("xyz")
    SubElement(fixed, "origin", xyz=urdf_numbers(xyz), rpy=urdf_numbers(angles))
    write_text(path, xml_text(robot))
    write_json(path.with_name(f"{path.stem}-joints.json"), {j.name: j.state for j in estimate.joints}, indent=1)


def _inertial(mesh: trimesh.Trimesh) -> Element:
    mesh.density = DENSITY
    inertia = mesh.moment_inertia
    element = Element("inertial")
    SubElement(element, "origin", xyz=urdf_numbers(mesh.center_mass), rpy="0 0 0")
    SubElement(element, "mass", value=repr(float(mesh.mass)))
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    SubElement(element, "inertia", {name: repr(float(inertia[place])) for name, place in places.items()})
    return element
