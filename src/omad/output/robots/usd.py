"""USD: the object as an articulation of UsdPhysics, in the estimated state."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from omad.common.errors import InputError
from omad.common.files import write_text
from omad.geometry.joint_kinds import Motion, elementary
from omad.geometry.mesh import Mesh

from ..picture import part_colours
from .robot import GRAVITY, Robot, Solid

CREEP = 1e-3
"""Radians or metres per second at which a joint's drive brakes with its whole friction: USD knows no other."""


def save_usd(robot: Robot, path: str | Path) -> None:
    """Write ``path`` (.usda): metres, ``robot.root``, links where they were seen; zero of every joint is the rest
    state. Raises InputError where USD is not installed, and for an object with a joint that turns and slides at once,
    which its physics do not know."""
    try:
        pxr: Any = SimpleNamespace(**{name: import_module(f"pxr.{name}") for name in PARTS})
    except ImportError as error:
        raise InputError("format usd needs OpenUSD, which is not installed; pip install 'omad[usd]'") from error
    check_joints(robot.model.joint_names, robot.model.tree.motions)
    stage = _stage(pxr, robot)
    write_text(Path(path), stage.GetRootLayer().ExportToString())


def check_joints(names: Sequence[str], motions: Sequence[Motion]) -> None:
    """Raises InputError for a joint that turns and slides at once."""
    for name, motion in zip(names, motions, strict=True):
        if len(elementary(motion)) > 1:
            raise InputError(f"format usd: {name} turns and slides at once, which it cannot say; choose urdf or mjcf")


PARTS = ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdPhysics", "Vt")
"""Modules of OpenUSD that are used."""
JOINTS = "joints"
"""The scope of an object's joints."""


def _stage(pxr: Any, robot: Robot) -> Any:
    stage, model = pxr.Usd.Stage.CreateInMemory(), robot.model
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.z)
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    pxr.UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    scene = pxr.UsdPhysics.Scene.Define(stage, "/physics")
    scene.CreateGravityDirectionAttr(_vector(pxr, robot.down))
    scene.CreateGravityMagnitudeAttr(GRAVITY)
    root = pxr.UsdGeom.Xform.Define(stage, f"/{pxr.Tf.MakeValidIdentifier(model.name)}").GetPrim()
    stage.SetDefaultPrim(root)
    pxr.UsdPhysics.ArticulationRootAPI.Apply(root)
    joints = pxr.UsdGeom.Scope.Define(stage, root.GetPath().AppendChild(JOINTS)).GetPath()
    links = [root.GetPath().AppendChild(name) for name in _names(pxr, model.part_names, (JOINTS,))]
    for part, path in enumerate(links):
        _link(pxr, stage, robot, part, path)
    fast = f"{robot.root.name}_to_{links[0].name}"
    fixed = pxr.UsdPhysics.FixedJoint.Define(stage, joints.AppendChild(fast))
    _put(pxr, fixed, 0, robot.T_root_link[0])
    fixed.CreateBody1Rel().SetTargets([links[0]])
    _put(pxr, fixed, 1, np.eye(4))
    names = _names(pxr, model.joint_names, (fast,))
    for joint, (name, parent) in enumerate(zip(names, model.tree.parents, strict=True)):
        _joint(pxr, stage, robot, joint, joints.AppendChild(name), (links[parent], links[joint + 1]))
    return stage


def _link(pxr: Any, stage: Any, robot: Robot, part: int, path: Any) -> None:
    model, place, T = robot.model, robot.places[part], robot.T_root_link[part]
    link = pxr.UsdGeom.Xform.Define(stage, path)
    link.AddTransformOp().Set(pxr.Gf.Matrix4d(T.T.tolist()))  # of row vectors
    pxr.UsdPhysics.RigidBodyAPI.Apply(link.GetPrim())
    _weigh(pxr, link.GetPrim(), robot.solids[part])
    colour = [_vector(pxr, part_colours(part))]
    _mesh(pxr, stage, path.AppendChild("surface"), model.parts[part], place).CreateDisplayColorAttr(colour)
    for number, body in enumerate(robot.bodies[part]):
        mesh = _mesh(pxr, stage, path.AppendChild(f"body_{number}"), body, place)
        mesh.CreatePurposeAttr(pxr.UsdGeom.Tokens.guide)
        pxr.UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
        hull = pxr.UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim())
        hull.CreateApproximationAttr(pxr.UsdPhysics.Tokens.convexHull)


def _weigh(pxr: Any, prim: Any, solid: Solid) -> None:
    moments, axes = np.linalg.eigh(solid.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    mass = pxr.UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(solid.mass)
    mass.CreateCenterOfMassAttr(_vector(pxr, solid.centre))
    mass.CreateDiagonalInertiaAttr(_vector(pxr, moments))
    mass.CreatePrincipalAxesAttr(_quaternion(pxr, axes))


def _mesh(pxr: Any, stage: Any, path: Any, mesh: Mesh, place: np.ndarray) -> Any:
    shape = pxr.UsdGeom.Mesh.Define(stage, path)
    points = (mesh.vertices - place).astype(np.float32)
    shape.CreatePointsAttr(pxr.Vt.Vec3fArray.FromNumpy(points))
    shape.CreateFaceVertexCountsAttr([3] * len(mesh.faces))
    shape.CreateFaceVertexIndicesAttr(pxr.Vt.IntArray.FromNumpy(mesh.faces.ravel().astype(np.int32)))
    shape.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    shape.CreateExtentAttr(pxr.UsdGeom.PointBased.ComputeExtent(shape.GetPointsAttr().Get()))
    return shape


def _joint(pxr: Any, stage: Any, robot: Robot, joint: int, path: Any, ends: tuple[Any, Any]) -> None:
    model, physics = robot.model, pxr.UsdPhysics
    motion, limits = model.tree.motions[joint], model.limits[joint]
    kind, drive, unit = (
        (physics.RevoluteJoint, "angular", np.degrees(1.0)) if motion.turns else (physics.PrismaticJoint, "linear", 1.0)
    )
    made = kind.Define(stage, path)
    made.CreateBody0Rel().SetTargets([ends[0]])
    made.CreateBody1Rel().SetTargets([ends[1]])
    made.CreateAxisAttr(pxr.UsdGeom.Tokens.x)
    low, high = (limits * unit).tolist()
    made.CreateLowerLimitAttr(low)
    made.CreateUpperLimitAttr(high)
    frame = np.eye(4)
    frame[:3, :3] = Rotation.align_vectors(model.axes[joint][None], [[1.0, 0.0, 0.0]])[0].as_matrix()
    _put(pxr, made, 1, frame)
    frame[:3, 3] = robot.offsets[joint]
    _put(pxr, made, 0, frame)
    brake = physics.DriveAPI.Apply(made.GetPrim(), drive)
    brake.CreateTypeAttr(physics.Tokens.force)
    brake.CreateTargetVelocityAttr(0.0)
    brake.CreateDampingAttr(float(robot.friction[joint] / CREEP / unit))
    brake.CreateMaxForceAttr(float(robot.friction[joint]))


def _put(pxr: Any, joint: Any, end: int, T: np.ndarray) -> None:
    """Where a joint stands in the frame of the first (0) or second (1) of the bodies that it links."""
    place, turn = (joint.CreateLocalPos0Attr, joint.CreateLocalRot0Attr)
    if end:
        place, turn = (joint.CreateLocalPos1Attr, joint.CreateLocalRot1Attr)
    place(_vector(pxr, T[:3, 3]))
    turn(_quaternion(pxr, T[:3, :3]))


def _vector(pxr: Any, values: np.ndarray) -> Any:
    return pxr.Gf.Vec3f(*np.asarray(values, dtype=float).tolist())


def _quaternion(pxr: Any, rotation: np.ndarray) -> Any:
    w, *xyz = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True).tolist()
    return pxr.Gf.Quatf(w, pxr.Gf.Vec3f(*xyz))


def _names(pxr: Any, names: Sequence[str], taken: Sequence[str]) -> list[str]:
    """As prims beside those that are ``taken`` may be called, no two alike."""
    found = list(taken)
    for name in map(pxr.Tf.MakeValidIdentifier, names):
        while name in found:
            name += "_"
        found.append(name)
    return found[len(taken) :]
