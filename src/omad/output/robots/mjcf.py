"""MJCF: the object for MuJoCo, one file with its meshes in it."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omad.common.errors import InputError
from omad.common.files import write_text
from omad.geometry.joint_kinds import elementary
from omad.geometry.mesh import Mesh
from omad.objects.urdf import COUPLED

from ..picture import part_colours
from .robot import GRAVITY, Robot

SHOWN, COLLIDES = 2, 3
"""Groups of geoms, as MuJoCo's viewer shows the one and hides the other at first."""
STIFF = [0.9999, 0.9999, 0.001, 0.5, 2.0]
"""MuJoCo's ``solimpfriction``: joints hardly creep."""


def save_mjcf(robot: Robot, path: str | Path) -> None:
    """Write ``path`` (.xml). The worldbody is ``robot.root``, the base is fast in it. Zero is the rest state; the
    keyframe ``estimate`` has the estimated states. Raises InputError where MuJoCo is not installed."""
    try:
        mujoco: Any = import_module("mujoco")
    except ImportError as error:
        raise InputError("format mjcf needs MuJoCo, which is not installed; pip install 'omad[mujoco]'") from error
    write_text(Path(path), _spec(mujoco, robot).to_xml())


def _spec(mujoco: Any, robot: Robot) -> Any:
    model, spec = robot.model, mujoco.MjSpec()
    spec.modelname = model.name
    spec.compiler.degree = False
    spec.option.gravity = GRAVITY * robot.down
    base = robot.T_root_link[0]
    quaternion = Rotation.from_matrix(base[:3, :3]).as_quat(scalar_first=True)
    links = [spec.worldbody.add_body(name=model.part_names[0], pos=base[:3, 3], quat=quaternion)]
    states: list[list[float]] = []
    for joint, (name, parent, offset) in enumerate(
        zip(model.part_names[1:], model.tree.parents, robot.offsets, strict=True)
    ):
        links.append(links[parent].add_body(name=name, pos=offset))
        states.append(_add_joint(mujoco, spec, links[-1], robot, joint))
    for part, link in enumerate(links):
        _add_shapes(mujoco, spec, link, robot, part)
    # MuJoCo numbers a link's children, and theirs, before the next link
    order = sorted(range(len(states)), key=lambda joint: model.tree.path(joint + 1))
    spec.add_key(name="estimate", qpos=[state for joint in order for state in states[joint]])
    spec.compile()
    return spec


def _add_joint(mujoco: Any, spec: Any, link: Any, robot: Robot, joint: int) -> list[float]:
    """The states of the joints that it takes: one, or one that turns and one that slides along with it."""
    model, state = robot.model, float(robot.states[joint])
    motion, name, limits = model.tree.motions[joint], model.joint_names[joint], model.limits[joint]
    first, *second = elementary(motion)
    kinds = {True: mujoco.mjtJoint.mjJNT_HINGE, False: mujoco.mjtJoint.mjJNT_SLIDE}
    held = {"damping": robot.damping[joint], "frictionloss": robot.friction[joint], "solimp_friction": STIFF}
    both = {"axis": model.axes[joint], "limited": True}
    link.add_joint(name=name, type=kinds[first.turns], range=limits, **both, **held)
    for _ in second:
        coupled, travel = f"{name}{COUPLED}", np.sort(motion.slide * limits)
        link.add_joint(name=coupled, type=kinds[False], range=travel, **both)
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=coupled, name2=name)
        equality.data[:2], equality.solimp = (0.0, motion.slide), STIFF
    return [state, *(motion.slide * state for _ in second)]


def _add_shapes(mujoco: Any, spec: Any, link: Any, robot: Robot, part: int) -> None:
    solid, (xx, xy, xz, yy, yz, zz) = robot.solids[part], robot.solids[part].inertia[np.triu_indices(3)]
    link.explicitinertial, link.mass, link.ipos = True, solid.mass, solid.centre
    link.fullinertia = [xx, yy, zz, xy, xz, yz]
    colour = [*part_colours(part), 1.0]
    shapes = [(SHOWN, robot.model.parts[part]), *((COLLIDES, body) for body in robot.bodies[part])]
    for number, (group, mesh) in enumerate(shapes):
        name = f"{part}-{number}-{link.name}"  # parts may be called in any way
        _add_mesh(mujoco, spec, name, mesh, robot.places[part])
        collides = int(group == COLLIDES)
        link.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, group=group, rgba=colour, mass=0.0,
            contype=collides, conaffinity=collides,
        )  # fmt: skip


def _add_mesh(mujoco: Any, spec: Any, name: str, mesh: Mesh, place: np.ndarray) -> None:
    vertices, faces = (mesh.vertices - place).astype(np.float32), mesh.faces.astype(np.int32)
    # of a shell: masses are given, and thin bodies have too little volume for the compiler
    shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.add_mesh(name=name, uservert=vertices.ravel(), userface=faces.ravel(), inertia=shell)
