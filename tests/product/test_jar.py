"""A jar with a screw lid, whose joint turns and slides at once: from its spec file to estimates and files."""

import json
from pathlib import Path

import numpy as np
import pytest
import yourdfpy

import omad
from helpers.own_models import JAR, JAR_PITCH, jar, write_jars
from omad.cli.main import run
from omad.data.rendering.standard_views import standard_view
from omad.data.urdf_import.articulation import read_urdf
from omad.data.urdf_import.folder import load_folder
from omad.geometry.joint_kinds import motion_of
from omad.objects.urdf import write_urdf
from omad.output.gltf import save_glb
from omad.output.page import page_data
from omad.output.robots.mjcf import save_mjcf
from omad.output.robots.robot import Robot, link_frames
from omad.output.robots.urdf import save_robot
from omad.output.robots.usd import save_usd
from omad.output.ros import ros_messages

TURN = 2 * np.pi


@pytest.fixture(scope="module")
def spec(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("jar") / "jar.toml"
    path.write_text(JAR)
    return path


def test_spec_states_the_pitch_in_metres(spec):
    category = omad.get_category(str(spec))
    assert category.metric_tree.motions == (motion_of("screw", JAR_PITCH),)
    assert category.tree.motions[0].slide == pytest.approx(JAR_PITCH / TURN / 0.1)
    np.testing.assert_allclose(category.metric_limits, [[0, 1.5 * TURN]])


@pytest.mark.parametrize(("old", "new"), [(f"pitch = {JAR_PITCH}, ", ""), ('"screw"', '"revolute"'), ("0.03", "0")])
def test_senseless_pitch_is_refused_by_file_and_field(tmp_path, old, new):
    path = tmp_path / "bad.toml"
    path.write_text(JAR.replace(old, new))
    with pytest.raises(omad.InputError, match=r"bad\.toml.*pitch"):
        omad.get_category(str(path))


def test_urdf_says_it_with_two_joints_and_is_read_back(tmp_path, spec):
    made = jar()
    file = write_urdf(made, tmp_path / "jar.urdf")
    back = read_urdf(file, omad.get_category(str(spec)))
    assert back.tree.motions[0].turn == 1
    assert back.tree.motions[0].slide == pytest.approx(JAR_PITCH / TURN)
    np.testing.assert_allclose(back.limits, made.limits)
    robot = yourdfpy.URDF.load(file)
    for state in (0.0, 1.0, 3.0, 3 * np.pi):
        robot.update_cfg({"lid_joint": state})
        T = robot.get_transform("lid", "jar")
        expected = made.part_transforms(np.array([state]))[1]
        np.testing.assert_allclose(T[:3, :3], expected[:3, :3], atol=1e-7)
        place = expected[:3, :3] @ made.pivots[0] + expected[:3, 3]  # links stand at their pivots
        np.testing.assert_allclose(T[:3, 3], place, atol=1e-7)
        assert expected[1, 3] == pytest.approx(state / TURN * JAR_PITCH)


def test_a_foreign_file_of_it_is_imported(tmp_path, spec):
    write_jars(tmp_path / "jars", 3)
    found = load_folder(tmp_path / "jars", omad.get_category(str(spec)))
    assert not found.refused
    for model in found.models:
        assert model.tree.motions[0].slide == pytest.approx(JAR_PITCH / TURN)
        rise = model.part_transforms(np.array([TURN]))[1][1, 3]
        assert rise == pytest.approx(JAR_PITCH)


@pytest.fixture(scope="module")
def weights(tmp_path_factory, spec) -> Path:
    """A prior and a network that have seen jars for some seconds."""
    folder = tmp_path_factory.mktemp("weights")
    write_jars(folder / "jars", 4)
    common = ["--category", str(spec), "--source", str(folder / "jars"), "--batch", "8", "--threads", "1"]
    common += ["--variants", "20"]
    assert run(["train", "prior", *common, "--output", str(folder / "prior"), "--steps", "60"]) == 0
    net = ["--prior", str(folder / "prior"), "--output", str(folder / "net"), "--steps", "20"]
    assert run(["train", "net", *common, *net]) == 0
    return folder / "net"


@pytest.fixture(scope="module")
def estimate(weights, spec) -> omad.Estimate:
    """Of a jar whose lid is half a turn open, with the state known: a few steps teach too little to see it."""
    category = omad.get_category(str(spec))
    view = standard_view(jar(), category, (0, 0, 0))
    estimator = omad.Estimator.from_pretrained(weights, device="cpu")
    return estimator(view.observation(), omad.Known(joint_states=np.array([np.pi])))


@pytest.mark.slow
def test_joint_moves_along_a_helix(estimate):
    joint = estimate.joints[0]  # its axis comes from single precision
    assert (joint.type, joint.pivot is None) == ("screw", False)
    np.testing.assert_allclose(joint.limits, [0, 1.5 * TURN])
    start = joint.pivot + 0.04 * np.cross(joint.axis, [0.0, 0.0, 1.0])
    path = estimate.waypoints("lid", start, to_state=joint.state + TURN, steps=9)
    np.testing.assert_allclose(path[-1] - path[0], JAR_PITCH * joint.axis, atol=1e-7)
    along = (path - path[0]) @ joint.axis
    np.testing.assert_allclose(along, np.linspace(0, JAR_PITCH, 9), atol=1e-7)
    across = path - joint.pivot - ((path - joint.pivot) @ joint.axis)[:, None] * joint.axis
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), np.linalg.norm(across[0]), atol=1e-7)
    step = 1e-6
    velocity = (estimate.waypoints("lid", start, joint.state + step, 2)[1] - start) / step
    np.testing.assert_allclose(joint.twist[3:] + np.cross(joint.twist[:3], start), velocity, atol=1e-6)


@pytest.mark.slow
def test_every_format_says_what_it_can(estimate, spec, tmp_path):
    estimate.save_urdf(tmp_path / "jar.urdf")
    back = read_urdf(tmp_path / "jar.urdf", omad.get_category(str(spec)))
    assert back.tree.motions[0].slide == pytest.approx(JAR_PITCH / TURN)
    save_glb(estimate, tmp_path / "jar.glb")
    data = (tmp_path / "jar.glb").read_bytes()
    content = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    paths = {channel["target"]["path"] for channel in content["animations"][0]["channels"]}
    assert paths == {"rotation", "translation"}
    node = next(node for node in content["nodes"] if node["name"] == "lid_joint")
    lift = np.array(node["translation"]) - estimate.canonical_pivots[0]
    np.testing.assert_allclose(lift, JAR_PITCH / 2 * estimate.canonical_axes[0], atol=1e-6)
    messages = ros_messages(estimate)
    assert messages["joint_state"]["position"] == [pytest.approx(np.pi)]
    save_robot(Robot.of(estimate, "robot"), tmp_path / "robot.urdf")
    robot = yourdfpy.URDF.load(tmp_path / "robot.urdf", load_meshes=False)
    robot.update_cfg({"lid_joint": np.pi})
    T = robot.get_transform("lid", "camera_optical_frame")
    lid = next(t for t in messages["tf"]["transforms"] if t["child_frame_id"] == "lid")["transform"]["translation"]
    parent = robot.get_transform("jar", "camera_optical_frame")
    np.testing.assert_allclose((np.linalg.inv(parent) @ T)[:3, 3], [lid[axis] for axis in "xyz"], atol=1e-6)


@pytest.mark.slow
def test_mujoco_turns_and_lifts_the_lid_at_once(estimate, tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra: pip install 'omad[mujoco]'")
    save_mjcf(Robot.of(estimate, "robot"), tmp_path / "robot.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    T = link_frames(estimate)[1]
    np.testing.assert_allclose(data.body("lid").xpos, T[:3, 3], atol=1e-5)
    np.testing.assert_allclose(data.body("lid").xmat.reshape(3, 3), T[:3, :3], atol=1e-5)
    model.opt.gravity[:] = 0
    data.qfrc_applied[0] = -2 * model.dof_frictionloss[0]
    while data.qpos[0] > estimate.joint_states[0] - 0.5:
        mujoco.mj_step(model, data)
    data.qfrc_applied[0] = 0
    for _ in range(500):  # the two are held together softly
        mujoco.mj_step(model, data)
    turned, lifted = data.qpos
    assert 0 < turned < estimate.joint_states[0]
    assert lifted == pytest.approx(JAR_PITCH / TURN * turned, abs=1e-4)


@pytest.mark.slow
def test_usd_knows_no_screw(estimate, tmp_path):
    pytest.importorskip("pxr", reason="OpenUSD is an extra: pip install 'omad[usd]'")
    with pytest.raises(omad.InputError, match="format usd: lid_joint turns and slides"):
        save_usd(Robot.of(estimate, "robot"), tmp_path / "robot.usda")


@pytest.mark.slow
def test_page_carries_both_numbers(estimate, spec):
    category = omad.get_category(str(spec))
    [joint] = page_data(standard_view(jar(), category, (0, 0, 0)).observation(), estimate)["joints"]
    assert joint["turn"] == 1
    assert joint["slide"] == pytest.approx(JAR_PITCH / TURN)


def test_no_room_but_the_joints_own_knows_the_word():
    source = Path(omad.__file__).parent
    told = {path.relative_to(source).as_posix() for path in source.rglob("*.py") if '"screw"' in path.read_text()}
    assert told == {"geometry/joint_kinds.py"}
