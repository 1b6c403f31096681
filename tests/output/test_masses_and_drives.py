"""What simulators are told of masses, gravity and what holds joints, read back from what was written."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import omad
from helpers.own_models import JAR_PITCH, jar
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.geometry.joint_kinds import motion_of
from omad.geometry.kinematics import KinematicTree
from omad.objects.category_file import get_category
from omad.output.frame import CAMERA
from omad.output.robots.mjcf import save_mjcf
from omad.output.robots.robot import DAMPING, GRAVITY, Robot, Solid
from omad.output.robots.usd import CREEP, save_usd


@cache
def seen(name: str) -> omad.Estimate:
    category = get_category(name)
    view = standard_view(generate(category, 1, "test"), category, (0, 1))
    return omad.Estimator.from_pretrained(name, "cpu")(view.observation())


@cache
def robot(name: str) -> Robot:
    """Of solids whose inertia has all six numbers."""
    rng, found = np.random.default_rng(0), Robot.of(seen(name), "robot")
    odd = []
    for solid in found.solids:
        turn = Rotation.random(rng=rng).as_matrix()
        odd.append(replace(solid, inertia=turn @ np.diag([2e-3, 3e-3, 4e-3]) @ turn.T))
    return type("Odd", (Robot,), {"solids": tuple[Solid, ...](odd)})(**vars_of(found))


def vars_of(found: Robot) -> dict:
    return {name: getattr(found, name) for name in ("model", "states", "root", "T_root_link")}


@pytest.mark.parametrize("name", ["laptop", "drawer"])
def test_mujoco_knows_inertia_gravity_and_brakes(name, tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra: pip install 'omad[mujoco]'")
    save_mjcf(robot(name), tmp_path / "robot.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    bodies = [model.body(part).id for part in robot(name).model.part_names]
    for body, solid in zip(bodies, robot(name).solids, strict=True):
        axes = Rotation.from_quat(model.body_iquat[body], scalar_first=True).as_matrix()
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        np.testing.assert_allclose(inertia, solid.inertia, rtol=1e-4, atol=1e-8)
    np.testing.assert_allclose(model.dof_damping, DAMPING * model.dof_frictionloss, rtol=1e-4)
    down = -seen(name).T_camera_base[:3, 1]
    np.testing.assert_allclose(robot(name).down, down)
    np.testing.assert_allclose(model.opt.gravity, GRAVITY * down, atol=1e-4)


@pytest.mark.parametrize(("name", "drive", "unit"), [("laptop", "angular", np.degrees(1.0)), ("drawer", "linear", 1.0)])
def test_usd_knows_inertia_limits_and_brakes(name, drive, unit, tmp_path):
    pytest.importorskip("pxr", reason="USD is an extra: pip install 'omad[usd]'")
    from pxr import Usd, UsdPhysics

    save_usd(robot(name), tmp_path / "robot.usda")
    stage = Usd.Stage.Open(str(tmp_path / "robot.usda"))
    links = [UsdPhysics.MassAPI(prim) for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.MassAPI)]
    for link, solid in zip(links, robot(name).solids, strict=True):
        turn = link.GetPrincipalAxesAttr().Get()
        axes = Rotation.from_quat([turn.GetReal(), *turn.GetImaginary()], scalar_first=True).as_matrix()
        inertia = axes @ np.diag(link.GetDiagonalInertiaAttr().Get()) @ axes.T
        np.testing.assert_allclose(inertia, solid.inertia, rtol=1e-4, atol=1e-8)
    kind = UsdPhysics.RevoluteJoint if drive == "angular" else UsdPhysics.PrismaticJoint
    joints = [kind(prim) for prim in stage.Traverse() if prim.IsA(kind)]
    for joint, limits, friction in zip(joints, robot(name).model.limits, robot(name).friction, strict=True):
        told = joint.GetLowerLimitAttr().Get(), joint.GetUpperLimitAttr().Get()
        assert told == pytest.approx(tuple(unit * limits), rel=1e-5)
        brake = UsdPhysics.DriveAPI(joint.GetPrim(), drive)
        assert brake.GetDampingAttr().Get() == pytest.approx(friction / CREEP / unit)
        assert brake.GetMaxForceAttr().Get() == pytest.approx(friction)


@pytest.mark.parametrize("pitch", [JAR_PITCH, -JAR_PITCH])
def test_mujoco_knows_a_screw_of_either_hand(pitch, tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra: pip install 'omad[mujoco]'")
    model = replace(jar(), tree=KinematicTree((0,), (motion_of("screw", pitch),)))
    frames = np.tile(np.eye(4), (2, 1, 1))
    frames[1, :3, 3] = model.pivots[0]
    save_mjcf(Robot(model, np.array([np.pi]), CAMERA, frames), tmp_path / "jar.xml")
    read = mujoco.MjModel.from_xml_path(str(tmp_path / "jar.xml"))
    assert (read.jnt_range[:, 0] < read.jnt_range[:, 1]).all()
    data = mujoco.MjData(read)
    mujoco.mj_resetDataKeyframe(read, data, 0)
    mujoco.mj_forward(read, data)
    lid = data.body("lid")
    assert lid.xpos[1] - frames[1, 1, 3] == pytest.approx(pitch / 2)  # half a turn
    assert lid.xmat.reshape(3, 3)[0, 0] == pytest.approx(-1)
