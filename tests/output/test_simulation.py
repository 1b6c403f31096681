"""Exported objects in a simulator: no two links touch in any state, and nothing moves by itself.

MuJoCo reads what was written and steps it, with gravity, for two seconds from some of them. Parent pairs, which
simulators leave out by default, are checked, too.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import omad
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.data.rendering.viewpoints import keep_possible
from omad.geometry.mesh import convex_hull
from omad.geometry.rigid import carry_each
from omad.model.checkpoint import shipped_categories
from omad.objects.category_file import get_category
from omad.output.formats import save_formats
from omad.output.frame import CAMERA
from omad.output.robots.robot import GRAVITY, HOLD, Robot, Solid

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra: pip install 'omad[mujoco]'")

SECONDS = 2.0
STATES = 20
LEFT = {0, 1, *range(2, STATES + 2, 3)}
"""Those of ``some_states`` that are left to themselves: rest, the estimate and every third of the others."""
STILL = 2e-3
"""Radians or metres: friction is a soft constraint, which creeps a little."""


@cache
def seen(name: str) -> tuple[omad.Observation, omad.Estimate]:
    category = get_category(name)
    observation = standard_view(generate(category, 1, "test"), category, (0, 1)).observation()
    return observation, omad.Estimator.from_pretrained(name, "cpu")(observation)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Of a category, the estimate and the folder that it was exported to, once for all tests."""

    @cache
    def export(name: str) -> tuple[omad.Estimate, Path]:
        observation, estimate = seen(name)
        folder = tmp_path_factory.mktemp(name)
        save_formats(estimate, observation, folder, ["mjcf", "urdf"])
        return estimate, folder

    return export


def compiled(file, with_parents: bool, down: np.ndarray | None = None):
    """What was written, as MuJoCo has it."""
    spec = mujoco.MjSpec.from_file(str(file))
    if with_parents:
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    if down is not None:
        spec.option.gravity = 9.81 * down
    return spec.compile()


def some_states(model, estimate: omad.Estimate) -> np.ndarray:
    """(N, J) rest, the estimate and others, all within the limits."""
    limits = model.jnt_range.T
    drawn = np.random.default_rng(0).uniform(*limits, (STATES, model.nq))
    keep_possible(drawn, limits.T, estimate.category.joints)
    return np.clip(np.concatenate([np.zeros((1, model.nq)), estimate.joint_states[None], drawn]), *limits)


HERE = [pytest.param(name, marks=[] if name == "laptop" else pytest.mark.slow) for name in shipped_categories()]


@pytest.mark.parametrize("name", HERE)
def test_nothing_touches_and_nothing_moves_by_itself(name, written):
    """With parents, too, which is more than a simulator checks by itself."""
    estimate, folder = written(name)
    rng = np.random.default_rng(1)
    for down in (None, rng.normal(size=3)):
        model = compiled(folder / "robot.xml", True, None if down is None else down / np.linalg.norm(down))
        data = mujoco.MjData(model)
        for number, states in enumerate(some_states(model, estimate)):
            mujoco.mj_resetData(model, data)
            data.qpos[:] = states
            mujoco.mj_forward(model, data)
            assert data.ncon == 0
            if number not in LEFT:
                continue
            while data.time < SECONDS:
                mujoco.mj_step(model, data)
            assert np.abs(data.qpos - states).max() < STILL
            assert data.ncon == 0


@pytest.mark.parametrize("name", HERE)
def test_bodies_of_the_urdf_do_not_touch(name, written):
    estimate, folder = written(name)
    model = compiled(folder / "robot.urdf", True)
    data = mujoco.MjData(model)
    assert (model.dof_frictionloss > 0).all()
    assert (model.dof_damping > 0).all()
    for states in some_states(model, estimate):
        data.qpos[:] = states
        mujoco.mj_forward(model, data)
        assert data.ncon == 0


def test_a_joint_gives_way_to_twice_what_holds_it(written):
    _, folder = written("laptop")
    model = compiled(folder / "robot.xml", False)
    data = mujoco.MjData(model)
    for torque, moves in ((0.2, False), (4.0, True)):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        start = data.qpos.copy()
        data.qfrc_applied[:] = -torque * model.dof_frictionloss * np.sign(start)
        for _ in range(100):
            mujoco.mj_step(model, data)
        assert (np.abs(data.qpos - start).max() > 0.05) == moves


@pytest.mark.parametrize("name", HERE)
def test_pybullet_leaves_it_where_it_is(name, written):
    pybullet = pytest.importorskip("pybullet", reason="PyBullet is not installed")
    estimate, folder = written(name)
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(str(folder / "robot.urdf"), useFixedBase=True, physicsClientId=client)
    pybullet.setGravity(0, 9.81, 0, physicsClientId=client)
    joints = [pybullet.getJointInfo(body, j, client) for j in range(pybullet.getNumJoints(body, client))]
    moving = [info for info in joints if info[2] != pybullet.JOINT_FIXED]
    for info, joint in zip(moving, estimate.joints, strict=True):
        pybullet.resetJointState(body, info[0], np.clip(joint.state, *joint.limits), physicsClientId=client)
        brake = {"targetVelocity": 0, "force": info[7]}  # the joint's friction
        pybullet.setJointMotorControl2(body, info[0], pybullet.VELOCITY_CONTROL, physicsClientId=client, **brake)
    for _ in range(int(SECONDS * 240)):
        pybullet.stepSimulation(physicsClientId=client)
    after = [pybullet.getJointState(body, info[0], client)[0] for info in moving]
    pybullet.disconnect(client)
    for state, joint in zip(after, estimate.joints, strict=True):
        assert abs(state - np.clip(joint.state, *joint.limits)) < STILL


def test_a_part_of_one_keypoint_has_some_mass():
    point, empty = Solid.of(convex_hull(np.full((1, 3), 0.2))), Solid.of(None)
    assert (point.mass, point.inertia.tolist()) == (empty.mass, empty.inertia.tolist())
    thin = Solid.of(convex_hull(np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.05, 0]])))
    assert 0 < thin.mass < 0.1 * empty.mass


class Surfaces(Robot):
    """Without bodies, which take long."""

    bodies = ((), (), (), ())


def test_friction_holds_whatever_hangs_on_a_joint_in_every_state_and_no_more():
    category = get_category("desk_lamp")
    model = generate(category, 1, "test")
    still = np.zeros(3), CAMERA, np.repeat(np.eye(4)[None], 4, 0)
    robot = Surfaces(model, *still)
    masses = np.array([solid.mass for solid in robot.solids])
    centres = np.array([solid.centre for solid in robot.solids]) + robot.places
    worst = np.zeros(3)
    for states in np.random.default_rng(0).uniform(*model.limits.T, (300, 3)):
        placed = model.placed(states, np.eye(4))
        pulls = masses[:, None] * (carry_each(placed.T_camera_part, centres) - placed.pivots[:, None])
        moments = [np.cross(axis, pulls[joint, joint + 1 :].sum(0)) for joint, axis in enumerate(placed.axes)]
        worst = np.maximum(worst, GRAVITY * np.linalg.norm(moments, axis=1))
    assert (worst < 1.0001 * robot.friction / HOLD).all()
    assert (worst > 0.8 * robot.friction / HOLD).all()
    elsewhere = replace(model, pivots=model.pivots + 0.3 * model.axes)  # other points of the same axes
    np.testing.assert_allclose(Surfaces(elsewhere, *still).friction, robot.friction)
