"""Every format in the world frame: what other programs read there is what the camera saw, carried into the world."""

import json

import numpy as np
import pytest
import trimesh
import yourdfpy
from scipy.spatial.transform import Rotation

import omad
from helpers.command_line import LAPTOP, answer, laptop_view
from helpers.installed import installed
from omad.cli.main import run
from omad.geometry.rigid import carry, rigid
from omad.output.formats import FORMATS, save_formats
from omad.output.frame import Frame
from omad.output.robots.robot import link_frames
from omad.output.ros import ros_messages

T_WORLD_CAMERA = rigid(Rotation.from_euler("xyz", [-2.1, 0.2, 0.4]).as_matrix(), np.array([1.0, -2.0, 1.5]))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("world")
    observation = laptop_view().observation()
    estimate = omad.Estimator.from_pretrained("laptop", "cpu")(observation)
    extras = {"mjcf": "mujoco", "usd": "pxr", "rrd": "rerun"}
    formats = [name for name in FORMATS if name not in extras or installed(extras[name])]
    save_formats(estimate, observation, folder, formats, T_WORLD_CAMERA)
    return folder, estimate, T_WORLD_CAMERA @ link_frames(estimate)


def test_urdf(written):
    folder, estimate, links = written
    robot = yourdfpy.URDF.load(str(folder / "robot.urdf"))
    robot.update_cfg(json.loads((folder / "robot-joints.json").read_text()))
    assert robot.base_link == "world"
    for part, T in zip(estimate.category.parts, links, strict=True):
        assert np.allclose(robot.get_transform(part.name), T, atol=1e-9)


def test_one_format_by_its_name(written, tmp_path):
    save_formats(written[1], laptop_view().observation(), tmp_path, "ply")
    assert (tmp_path / "object.ply").exists()
    assert not (tmp_path / "robot.urdf").exists()


def test_mjcf(written):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra: pip install 'omad[mujoco]'")
    folder, estimate, links = written
    model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert np.allclose(model.opt.gravity, [0, 0, -9.81])
    for part, T in zip(estimate.category.parts, links, strict=True):
        body = data.body(part.name)
        assert np.allclose(body.xpos, T[:3, 3], atol=1e-5)
        assert np.allclose(body.xmat.reshape(3, 3), T[:3, :3], atol=1e-5)


def test_usd(written):
    Usd = pytest.importorskip("pxr.Usd", reason="OpenUSD is an extra: pip install 'omad[usd]'")
    from pxr import UsdGeom, UsdPhysics

    folder, estimate, links = written
    stage = Usd.Stage.Open(str(folder / "robot.usda"))
    root = stage.GetDefaultPrim()
    assert root.HasAPI(UsdPhysics.ArticulationRootAPI)
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    places = UsdGeom.XformCache()
    for part, T in zip(estimate.category.parts, links, strict=True):
        prim = root.GetChild(part.name)
        assert prim.HasAPI(UsdPhysics.RigidBodyAPI)
        assert UsdPhysics.MassAPI(prim).GetMassAttr().Get() > 0
        assert np.allclose(np.array(places.GetLocalToWorldTransform(prim)).T, T, atol=1e-9)
        bodies = [child for child in prim.GetChildren() if child.HasAPI(UsdPhysics.CollisionAPI)]
        assert bodies
        assert all(UsdPhysics.MeshCollisionAPI(body).GetApproximationAttr().Get() == "convexHull" for body in bodies)
    for joint, spec in zip(estimate.joints, estimate.category.joints, strict=True):
        made = UsdPhysics.RevoluteJoint(root.GetChild("joints").GetChild(joint.name))
        assert np.radians([made.GetLowerLimitAttr().Get(), made.GetUpperLimitAttr().Get()]) == pytest.approx(
            joint.limits
        )
        ends = []
        for body, place, turn in (
            (made.GetBody0Rel(), made.GetLocalPos0Attr(), made.GetLocalRot0Attr()),
            (made.GetBody1Rel(), made.GetLocalPos1Attr(), made.GetLocalRot1Attr()),
        ):
            prim = stage.GetPrimAtPath(body.GetTargets()[0])
            q = turn.Get()
            rotation = Rotation.from_quat([q.real, *q.imaginary], scalar_first=True).as_matrix()
            ends.append(np.array(places.GetLocalToWorldTransform(prim)).T @ rigid(rotation, np.array(place.Get())))
        parent, child = ends
        assert np.allclose(parent[:3, 3], child[:3, 3], atol=1e-5)
        assert np.allclose(parent[:3, 3], carry(T_WORLD_CAMERA, joint.pivot), atol=1e-5)
        assert np.allclose(parent[:3, 0], T_WORLD_CAMERA[:3, :3] @ joint.axis, atol=1e-5)
        turned = Rotation.from_matrix(parent[:3, :3].T @ child[:3, :3]).as_rotvec()
        assert turned == pytest.approx([joint.state, 0, 0], abs=1e-5)  # about X, the axis it names
        assert spec.type == "revolute"


def test_ply_and_glb(written):
    folder, estimate, _ = written
    placed = [mesh.carried(T_WORLD_CAMERA).vertices for mesh in estimate.surface.posed()]
    for part, vertices in zip(estimate.category.parts, placed, strict=True):
        mesh = trimesh.load(folder / f"part-{part.name}.ply", process=False)
        assert np.allclose(mesh.vertices, vertices, atol=1e-5)
    scene = trimesh.load(folder / "object.glb")
    seen = estimate.object_model().posed_vertices(estimate.joint_states, T_WORLD_CAMERA @ estimate.T_camera_base)
    for part, vertices in zip(estimate.category.parts, seen, strict=True):
        T, geometry = scene.graph[part.name]
        x, y, z = carry(np.asarray(T), np.asarray(scene.geometry[geometry].vertices)).T  # y up, as glTF has it
        mine, theirs = np.stack([x, -z, y], 1), vertices
        assert np.allclose([mine.min(0), mine.max(0)], [theirs.min(0), theirs.max(0)], atol=1e-5)


def test_ros(written):
    folder, estimate, links = written
    messages = json.loads((folder / "ros.json").read_text())
    base = messages["tf"]["transforms"][0]
    assert (base["header"]["frame_id"], base["child_frame_id"]) == ("world", estimate.category.parts[0].name)
    place, turn = base["transform"]["translation"], base["transform"]["rotation"]
    assert np.allclose([place[axis] for axis in "xyz"], links[0, :3, 3])
    rotation = Rotation.from_quat([turn[axis] for axis in "xyzw"]).as_matrix()
    assert np.allclose(rotation, links[0, :3, :3])


def test_the_command_writes_in_the_world(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.save("depth.npy", laptop_view().depth)
    np.savetxt("pose.txt", T_WORLD_CAMERA)
    camera = "600,600,319.5,239.5"
    options = ["--intrinsics", camera, "--world", "pose.txt", "--formats", "ros"]
    found = answer(capsys, "estimate", "depth.npy", *LAPTOP, *options)
    messages = json.loads((tmp_path / found["output"] / "ros.json").read_text())
    base = messages["tf"]["transforms"][0]
    assert base["header"]["frame_id"] == "world"
    place = base["transform"]["translation"]
    assert np.allclose([place[axis] for axis in "xyz"], np.array(found["world"]["T_world_base"])[:3, 3])


def test_a_camera_whose_place_may_be_in_millimetres_is_warned_of(tmp_path, monkeypatch, capsys):
    """The answer is given all the same; a camera that is some metres from the origin needs no warning."""
    monkeypatch.chdir(tmp_path)
    np.save("depth.npy", laptop_view().depth)
    told = {}
    for name, unit in (("metres.txt", 1.0), ("millimetres.txt", 200.0)):
        T = T_WORLD_CAMERA.copy()
        T[:3, 3] *= unit
        np.savetxt(name, T)
        assert run(["estimate", "depth.npy", *LAPTOP, "--intrinsics", "600,600,319.5,239.5", "--world", name]) == 0
        told[name] = capsys.readouterr().err
    assert "millimetres.txt" in told["millimetres.txt"]
    assert "1000" in told["millimetres.txt"]
    assert "warning" not in told["metres.txt"]


def test_ros_messages_take_the_cameras_pose(written):
    folder, estimate, _ = written
    assert ros_messages(estimate, frame=T_WORLD_CAMERA) == json.loads((folder / "ros.json").read_text())
    assert ros_messages(estimate, frame=T_WORLD_CAMERA) == ros_messages(estimate, frame=Frame.of(T_WORLD_CAMERA))
    with pytest.raises(omad.InputError, match="T_world_camera: "):
        ros_messages(estimate, frame=np.eye(3))
