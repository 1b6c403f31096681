"""Estimates in other people's formats, judged by the programs that read them."""

import json
import re
import struct
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch
import trimesh
import yourdfpy
from PIL import Image
from scipy.spatial.transform import Rotation

import omad
from helpers.installed import installed
from helpers.pages import every_block
from omad.cli.main import run
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.estimation.estimate import Estimate, JointEstimate, PoseEstimate
from omad.estimation.part_labels import LabelledPoints
from omad.model.fitting.posed_object import PosedObject
from omad.objects.category_file import get_category
from omad.objects.pose import ObjectPose
from omad.output.formats import NEED, check_formats
from omad.output.gltf import save_glb
from omad.output.ply import part_surfaces, save_ply
from omad.output.rerun import log_frame, save_rrd
from omad.output.robots.mjcf import save_mjcf
from omad.output.robots.robot import Robot, link_frames
from omad.output.robots.urdf import save_robot
from omad.output.robots.usd import save_usd
from omad.output.ros import ros_messages

PAGE = Path(__file__).parents[2] / "docs" / "formats.md"


def made_up(parents: tuple[int, ...], types: tuple[str, ...]) -> Estimate:
    """An estimate of an object with this tree, random in everything else."""
    rng = np.random.default_rng(len(parents) + parents[-1])
    plain = get_category("drawer")
    joints = tuple(
        replace(plain.joints[0], name=f"joint_{i}", parent=parent, type=kind)
        for i, (parent, kind) in enumerate(zip(parents, types, strict=True))
    )
    parts = tuple(replace(plain.parts[0], name=f"part_{i}", keypoints=8, mirror=None) for i in range(len(parents) + 1))
    category = replace(plain, name="made-up", parts=parts, joints=joints)
    axes = rng.normal(size=(len(joints), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    pivots = rng.normal(size=(len(joints), 3)) * np.array([[kind == "revolute"] for kind in types])
    states = rng.uniform(-0.4, 0.6, len(joints))
    T_camera_base = np.eye(4)
    T_camera_base[:3] = np.column_stack([Rotation.random(rng=rng).as_matrix(), [0.1, 0.2, 1.5]])
    canonical = rng.normal(size=(category.num_keypoints, 3)) * 0.2
    still = ObjectPose(states, axes, pivots, np.tile(T_camera_base, (len(parts), 1, 1)))
    posed = PosedObject(np.zeros(2), still, canonical, axes, pivots, canonical)
    estimate = Estimate(
        **vars(posed), joints=(), category=category, observed_keypoints=canonical, keypoint_std=np.ones(len(canonical)),
        covariance=np.eye(2), base_std=np.ones(6), converged=True, residual=0.0, labelled=LabelledPoints.none(),
        initial=PoseEstimate(**vars(posed), joints=()),
    )  # fmt: skip
    limits = tuple(
        JointEstimate(j.name, j.type, s, 0.01, (-0.5, 0.8), axis, None, j.motion)
        for j, s, axis in zip(joints, states, axes, strict=True)
    )
    frames = replace(estimate, joints=limits).object_model().part_transforms(states, T_camera_base)
    seen = tuple(
        replace(
            joint,
            axis=frames[parent][:3, :3] @ axis,
            pivot=(frames[parent] @ np.append(pivot, 1))[:3] if joint.type == "revolute" else None,
        )
        for joint, parent, axis, pivot in zip(limits, parents, axes, pivots, strict=True)
    )
    part_of = np.array(category.part_of_keypoint)
    moved = np.einsum("mij,mj->mi", frames[part_of], np.column_stack([canonical, np.ones(len(canonical))]))[:, :3]
    return replace(estimate, joints=seen, placed=replace(still, T_camera_part=frames), keypoints=moved)


CHAINS = [
    ((0,), ("revolute",)),
    ((0,), ("prismatic",)),
    ((0, 1, 2), ("revolute", "prismatic", "revolute")),
    ((0, 0, 1), ("prismatic", "revolute", "revolute")),
]


@pytest.fixture(params=CHAINS, ids=lambda chain: "-".join(chain[1]))
def estimate(request) -> Estimate:
    return made_up(*request.param)


@pytest.fixture
def robot(estimate, tmp_path) -> yourdfpy.URDF:
    save_robot(Robot.of(estimate, "robot"), tmp_path / "robot.urdf")
    robot = yourdfpy.URDF.load(str(tmp_path / "robot.urdf"))
    robot.update_cfg(json.loads((tmp_path / "robot-joints.json").read_text()))
    return robot


def test_waypoints_are_those_of_the_urdf(estimate, robot):
    states = {joint.name: joint.state for joint in estimate.joints}
    T_world_camera = np.eye(4)
    T_world_camera[:3] = np.column_stack([Rotation.from_euler("xyz", [0.3, 1, 2]).as_matrix(), [1, 2, 3]])
    for spec, joint in zip(estimate.category.parts[1:], estimate.joints, strict=True):
        robot.update_cfg(states)
        handle = robot.get_transform(spec.name) @ trimesh.transformations.translation_matrix([0.1, 0.2, -0.3])
        local = np.linalg.inv(robot.get_transform(spec.name)) @ handle
        poses = estimate.waypoint_poses(spec.name, handle, 0.7, steps=5)
        points = estimate.waypoints(spec.name, torch.tensor(handle[:3, 3], requires_grad=True), 0.7, steps=5)
        in_world = estimate.waypoint_poses(spec.name, T_world_camera @ handle, 0.7, 5, T_world_camera)
        for state, pose, point, world in zip(np.linspace(joint.state, 0.7, 5), poses, points, in_world, strict=True):
            robot.update_cfg(states | {joint.name: state})
            assert np.allclose(pose, robot.get_transform(spec.name) @ local, atol=1e-9)
            assert np.allclose(point, pose[:3, 3], atol=1e-9)
            assert np.allclose(world, T_world_camera @ pose, atol=1e-9)


def test_twist_is_the_velocity_of_a_waypoint(estimate):
    for spec, joint in zip(estimate.category.parts[1:], estimate.joints, strict=True):
        point, small = np.array([0.3, -0.2, 1.0]), 1e-6
        ahead = estimate.waypoints(spec.name, point, joint.state + small, steps=2)[1]
        assert np.allclose((ahead - point) / small, joint.twist[3:] + np.cross(joint.twist[:3], point), atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("part_0", np.zeros(3), 0.1), "part_0"),
        (("part_1", np.zeros(2), 0.1), "shape"),
        (("part_1", np.zeros(3), np.nan), "to_state"),
        (("part_1", np.zeros(3), None), "to_state"),
        (("part_1", np.zeros(3), "a"), "to_state"),
        (("part_1", np.zeros(3), [0.1, 0.2]), "to_state"),
        (("part_1", np.zeros(3), [[0.1], [0.2, 0.3]]), "to_state"),
        (("part_1", np.zeros(3), 0.1, 0), "steps"),
        (("part_1", np.zeros(3), 0.1, 2.5), "steps"),
        (("part_1", [0.0, np.nan, 1.0], 0.1), "point: "),
        (("part_1", np.zeros(3), 0.1, 2, np.zeros((4, 4))), "T_world_camera: "),
    ],
)
def test_bad_waypoints_are_refused(arguments, message):
    with pytest.raises(omad.InputError, match=message):
        made_up(*CHAINS[0]).waypoints(*arguments)


def test_yourdfpy_shows_links_where_they_were_seen(estimate, robot):
    assert robot.base_link == "camera_optical_frame"
    for part, frame in zip(estimate.category.parts, link_frames(estimate), strict=True):
        assert np.allclose(robot.get_transform(part.name), frame, atol=1e-9)


def test_pybullet_shows_links_where_they_were_seen(estimate, tmp_path):
    pybullet = pytest.importorskip("pybullet", reason="PyBullet is not installed")
    save_robot(Robot.of(estimate, "robot"), tmp_path / "robot.urdf")
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(str(tmp_path / "robot.urdf"), useFixedBase=True, physicsClientId=client)
    states = json.loads((tmp_path / "robot-joints.json").read_text())
    links = {}
    for index in range(pybullet.getNumJoints(body, physicsClientId=client)):
        info = pybullet.getJointInfo(body, index, physicsClientId=client)
        links[info[12].decode()] = index
        if info[1].decode() in states:
            pybullet.resetJointState(body, index, states[info[1].decode()], physicsClientId=client)
    for part, frame in zip(estimate.category.parts, link_frames(estimate), strict=True):
        link = pybullet.getLinkState(body, links[part.name], computeForwardKinematics=True, physicsClientId=client)
        assert np.allclose(link[4], frame[:3, 3], atol=1e-5)
        assert np.allclose(Rotation.from_quat(link[5]).as_matrix(), frame[:3, :3], atol=1e-5)
        assert pybullet.getDynamicsInfo(body, links[part.name], physicsClientId=client)[0] > 0
    pybullet.disconnect(client)


def test_urdf_passes_a_strict_check(estimate, robot, tmp_path):
    root = ElementTree.parse(tmp_path / "robot.urdf").getroot()
    names = [element.get("name") for element in root]
    assert len(names) == len(set(names))
    for link in root.findall("link")[1:]:
        inertial = link.find("inertial")
        assert float(inertial.find("mass").get("value")) > 0
        i = {key: float(value) for key, value in inertial.find("inertia").attrib.items()}
        matrix = [[i["ixx"], i["ixy"], i["ixz"]], [i["ixy"], i["iyy"], i["iyz"]], [i["ixz"], i["iyz"], i["izz"]]]
        moments = np.linalg.eigvalsh(matrix)
        assert moments[0] > 0
        assert moments[0] + moments[1] >= moments[2]
        for mesh in link.iter("mesh"):
            assert not Path(mesh.get("filename")).is_absolute()
            assert (tmp_path / mesh.get("filename")).is_file()
    for joint in root.findall("joint"):
        if joint.get("type") != "fixed":
            assert np.isclose(np.linalg.norm(np.array(joint.find("axis").get("xyz").split(), float)), 1)
            assert {"lower", "upper", "effort", "velocity"} == set(joint.find("limit").attrib)


def read_glb(path: Path) -> tuple[dict, list[np.ndarray]]:
    """Its JSON, and the numbers of each accessor."""
    data, numbers = path.read_bytes(), []
    magic, version, length, json_length = struct.unpack("<4sIII", data[:16])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    content, stored = json.loads(data[20 : 20 + json_length]), data[28 + json_length :]
    for a in content["accessors"]:
        view, kind = content["bufferViews"][a["bufferView"]], "<f4" if a["componentType"] == 5126 else "<u4"
        values = np.frombuffer(stored, kind, view["byteLength"] // 4, view["byteOffset"])
        numbers.append(values.reshape(a["count"], -1))
    return content, numbers


def test_glb_is_the_tree_and_its_animation_moves_the_joints(estimate, tmp_path):
    save_glb(estimate, tmp_path / "object.glb")
    content, numbers = read_glb(tmp_path / "object.glb")
    (animation,) = content["animations"]
    for index, joint in enumerate(estimate.joints):
        channel, sampler = animation["channels"][index], animation["samplers"][index]
        node = content["nodes"][channel["target"]["node"]]
        keys = numbers[sampler["output"]].astype(float)
        assert node["name"] == joint.name
        assert np.allclose(keys[0], node[channel["target"]["path"]], atol=1e-6)
        axis = estimate.canonical_axes[index]
        if joint.type == "revolute":
            states = Rotation.from_quat(keys).as_rotvec() @ axis
        else:
            states = (keys - keys[0]) @ axis + joint.state
        assert np.allclose([states.min(), states.max()], joint.limits, atol=1e-5)
    scene = trimesh.load(tmp_path / "object.glb")
    for k, part in enumerate(estimate.category.parts):
        T, geometry = scene.graph[part.name]
        vertices = np.asarray(scene.geometry[geometry].vertices) @ T[:3, :3].T + T[:3, 3]
        posed = estimate.T_camera_base[:3] @ np.column_stack([vertices, np.ones(len(vertices))]).T
        own = estimate.keypoints[np.array(estimate.category.part_of_keypoint) == k]
        assert np.linalg.norm(posed.T[:, None] - own, axis=-1).min(1).max() < 1e-5


def test_glb_turns_all_the_way_where_a_joint_turns_many_times(tmp_path):
    screw = made_up((0,), ("revolute",))
    far = replace(screw, joints=(replace(screw.joints[0], limits=(-0.5, 80.0)),))
    save_glb(far, tmp_path / "object.glb")
    content, numbers = read_glb(tmp_path / "object.glb")
    turns = Rotation.from_quat(numbers[content["animations"][0]["samplers"][0]["output"]])
    steps = (turns[:-1].inv() * turns[1:]).as_rotvec() @ far.canonical_axes[0]  # the short way, as viewers go
    assert np.ptp(np.cumsum(steps)) == pytest.approx(80.5, abs=1e-3)


def test_ros_transforms_chain_to_the_links(estimate):
    messages = json.loads(json.dumps(ros_messages(estimate, np.int64(1_700_000_000_123_456_789))))
    stamp = {"sec": 1_700_000_000, "nanosec": 123_456_789}
    frames = {"camera_optical_frame": np.eye(4)}
    for message in messages["tf"]["transforms"]:
        assert message["header"]["stamp"] == stamp
        rotation, translation = message["transform"]["rotation"], message["transform"]["translation"]
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat([rotation[axis] for axis in "xyzw"]).as_matrix()
        T[:3, 3] = [translation[axis] for axis in "xyz"]
        frames[message["child_frame_id"]] = frames[message["header"]["frame_id"]] @ T
    for part, frame in zip(estimate.category.parts, link_frames(estimate), strict=True):
        assert np.allclose(frames[part.name], frame)
    assert messages["joint_state"]["name"] == [joint.name for joint in estimate.joints]
    assert messages["joint_state"]["position"] == [joint.state for joint in estimate.joints]


def test_the_keyframe_gives_each_joint_its_own_state(tmp_path):
    """MuJoCo has joints in another order where a part hangs on one before its neighbour."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra: pip install 'omad[mujoco]'")
    estimate = made_up((0, 0, 1), ("prismatic", "revolute", "revolute"))
    save_mjcf(Robot.of(estimate, "robot"), tmp_path / "robot.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    told = {model.joint(number).name: state for number, state in enumerate(model.key_qpos[0])}
    assert told == pytest.approx({joint.name: joint.state for joint in estimate.joints}, abs=1e-5)


def test_usd_tells_apart_names_that_it_must_change(tmp_path):
    usd = pytest.importorskip("pxr.Usd", reason="USD is an extra: pip install 'omad[usd]'")
    estimate = made_up((0, 0), ("prismatic", "revolute"))
    spec = estimate.category
    parts = tuple(replace(part, name=name) for part, name in zip(spec.parts, ("joints", "a b", "a-b"), strict=True))
    joints = tuple(replace(joint, name=name) for joint, name in zip(spec.joints, ("a b", "a-b"), strict=True))
    estimate = replace(estimate, category=replace(spec, parts=parts, joints=joints))
    save_usd(Robot.of(estimate, "robot"), tmp_path / "robot.usda")
    stage = usd.Stage.Open(str(tmp_path / "robot.usda"))
    prims = list(stage.Traverse())
    links = [prim.GetName() for prim in prims if "PhysicsRigidBodyAPI" in prim.GetAppliedSchemas()]
    assert links == ["joints_", "a_b", "a_b_"]
    moving = [prim for prim in prims if prim.GetTypeName() in ("PhysicsPrismaticJoint", "PhysicsRevoluteJoint")]
    ends = {prim.GetName(): prim.GetRelationship("physics:body1").GetTargets()[0].name for prim in moving}
    assert ends == {"a_b": "a_b", "a_b_": "a_b_"}


def test_what_usd_cannot_say_is_told_before_anything_is_done():
    pytest.importorskip("pxr", reason="USD is an extra: pip install 'omad[usd]'")
    check_formats(["usd"], get_category("laptop"))
    with pytest.raises(omad.InputError, match="thread turns and slides at once"):
        check_formats(["urdf", "usd"], get_category("jar"))


@pytest.fixture(scope="module")
def laptop():
    category = get_category("laptop")
    view = standard_view(generate(category, 0, "test"), category, (0, 1000))
    observation = omad.Observation.from_depth(view.depth, view.camera.K)
    return view, observation, omad.Estimator.from_pretrained("laptop")(observation)


def test_ply_lies_on_the_cloud(laptop, tmp_path):
    _, observation, estimate = laptop
    files = save_ply(estimate, tmp_path, observation)
    assert [file.name for file in files] == ["object.ply", "part-base.ply", "part-screen.ply"]
    mesh = trimesh.load(files[0])
    assert len(np.unique(mesh.visual.vertex_colors, axis=0)) == 2
    assert np.median(trimesh.proximity.closest_point(mesh, observation.points[::50])[1]) < 0.004
    bare = replace(estimate, surfaces=None)  # of weights without surfaces
    with_points = sum(len(part.vertices) for part in part_surfaces(bare, observation))
    assert with_points > sum(len(part.vertices) for part in part_surfaces(bare))


def test_recording_is_read_by_rerun(laptop, tmp_path):
    pytest.importorskip("rerun", reason="the recording is an extra: pip install 'omad[rerun]'")
    _, observation, estimate = laptop
    save_rrd(estimate, tmp_path / "object.rrd", observation)
    command = [sys.executable, "-m", "rerun", "rrd", "print", str(tmp_path / "object.rrd")]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert shown.returncode == 0, shown.stderr
    for entity in ("image/depth", "cloud", "keypoints", "parts/screen", "axes/hinge"):
        assert f"/camera/{entity}" in shown.stdout
    assert "/joints/hinge" in shown.stdout


@pytest.mark.parametrize(
    ("seen", "followed", "gone"),
    [
        (True, True, set()),
        (False, True, {"camera/image", "camera/cloud"}),
        (False, False, {"camera/image", "camera/cloud", "camera/keypoints", "camera/parts", "camera/axes"}),
    ],
)
def test_a_recording_takes_away_what_a_frame_does_not_show(seen, followed, gone, laptop):
    rr, stream, (_, observation, estimate, *_) = MagicMock(), MagicMock(), laptop
    estimate = estimate if seen else estimate.without_labels()
    log_frame(rr, stream, observation if seen else None, estimate if followed else None, static=False)
    logged = [call.args for call in stream.log.call_args_list]
    assert {entity for entity, what in logged if what is rr.Clear.return_value} == gone


def test_recording_without_rerun_names_the_cure(laptop, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(omad.InputError, match=r"omad\[rerun\]"):
        save_rrd(laptop[2], tmp_path / "object.rrd", laptop[1])


def test_torch_depth_is_as_good_as_numpy(laptop):
    view, observation, _ = laptop
    depth = torch.tensor(view.depth, requires_grad=True)
    same = omad.Observation.from_depth(depth, torch.tensor(view.camera.K), mask=torch.tensor(view.depth > 0))
    assert np.array_equal(same.points, observation.points)
    if torch.cuda.is_available():
        assert np.array_equal(omad.Observation.from_depth(depth.cuda(), view.camera.K).points, observation.points)


@pytest.mark.parametrize(("name", "package", "extra"), [(name, *need) for name, need in NEED.items()])
def test_a_missing_package_is_told_before_anything_is_done(name, package, extra, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    assert run(["estimate", "depth.png", "--category", "laptop", "--formats", "urdf", name]) == 2
    assert f"omad: --formats {name}: needs {package}; pip install 'omad[{extra}]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_page_runs(laptop, tmp_path, monkeypatch):
    """Commands and Python of the page, in its order; a block of a program that is not installed is left out."""
    view, observation, estimate = laptop
    Image.fromarray(np.rint(view.depth * 1000).astype(np.uint16)).save(tmp_path / "depth.png")
    monkeypatch.chdir(tmp_path)
    ran = 0
    names = {"view": observation, "estimate": estimate}
    for language, code in every_block(PAGE):
        if language == "python":
            named = [
                name
                for name in ("pybullet", "rerun", "mujoco", "pxr")
                if re.search(rf"\b(import|from) .*\b{name}\b", code)
            ]
            missing = [name for name in named if not installed(name)]
            if not missing:
                exec(code, names)
                ran += 1
        else:
            words = code.split()
            for name, extra in {"mjcf": "mujoco", "usd": "pxr"}.items():
                if not installed(extra):
                    words.remove(name)
            assert words[0] == "omad"
            assert run(words[1:]) == 0
    assert ran >= 4
