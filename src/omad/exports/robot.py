"""URDF for simulators: rooted in the camera frame, with masses, and the estimated state beside it."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from ..estimate import Estimate
from ..files import write_atomic
from ..observation import Observation
from ..urdf import write_urdf
from .surfaces import part_surfaces

CAMERA = "camera_optical_frame"
DENSITY = 300.0
"""kg per cubic metre of a part's hull; a guess, a depth image shows no mass."""


def link_frames(estimate: Estimate) -> np.ndarray:
    """(K, 4, 4) camera frame: where the URDF's links are at the estimated state. A link's frame stands at its joint's
    pivot; that of the base and of prismatic joints at the canonical origin."""
    frames = estimate.T_camera_part.copy()
    pivots = np.concatenate([np.zeros((1, 3)), estimate.canonical_pivots])
    frames[:, :3, 3] += np.einsum("kij,kj->ki", frames[:, :3, :3], pivots)
    return frames


def save_robot(estimate: Estimate, path: str | Path, observation: Observation | None = None) -> None:
    """Write ``path`` (.urdf), meshes beside it and ``<stem>-joints.json``, ``{joint name: state}``.

    The root link is ``camera_optical_frame``, a fixed joint puts the object where it was seen. Zero is the rest state,
    as limits refer to it: set the joints from the JSON file to see the estimate.
    """
    path = Path(path)
    model = replace(estimate.object_model(path.stem), parts=tuple(part_surfaces(estimate, observation)))
    write_urdf(model, path)
    tree = ElementTree.parse(path)
    robot = tree.getroot()
    places = np.concatenate([np.zeros((1, 3)), model.pivots])
    for link, mesh, place in zip(robot.findall("link"), model.parts, places, strict=True):
        link.insert(0, _inertial(trimesh.Trimesh(mesh.vertices - place, mesh.faces, process=False)))
    robot.insert(0, ElementTree.Element("link", name=CAMERA))
    fixed = ElementTree.SubElement(robot, "joint", name=f"{CAMERA}_to_{model.part_names[0]}", type="fixed")
    ElementTree.SubElement(fixed, "parent", link=CAMERA)
    ElementTree.SubElement(fixed, "child", link=model.part_names[0])
    T = estimate.T_camera_base
    angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz")
    ElementTree.SubElement(fixed, "origin", xyz=_numbers(T[:3, 3]), rpy=_numbers(angles))
    ElementTree.indent(tree)
    write_atomic(path, lambda temporary: tree.write(temporary, encoding="unicode", xml_declaration=True))
    states = json.dumps({joint.name: joint.state for joint in estimate.joints}, indent=1) + "\n"
    write_atomic(path.with_name(f"{path.stem}-joints.json"), lambda temporary: temporary.write_text(states))


def _inertial(mesh: trimesh.Trimesh) -> ElementTree.Element:
    mesh.density = DENSITY
    inertia = mesh.moment_inertia
    element = ElementTree.Element("inertial")
    ElementTree.SubElement(element, "origin", xyz=_numbers(mesh.center_mass), rpy="0 0 0")
    ElementTree.SubElement(element, "mass", value=repr(float(mesh.mass)))
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = {name: repr(float(inertia[place])) for name, place in names.items()}
    ElementTree.SubElement(element, "inertia", values)
    return element


def _numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
