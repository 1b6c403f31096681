"""Whatever shows an estimated object shows it in one place: that of the answer, where its surface was fitted."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy
from scipy.spatial.transform import Rotation

import omad
from helpers.categories import EVERY
from helpers.installed import installed
from omad.data.procedural import generate
from omad.data.rendering.standard_views import standard_view
from omad.geometry.rigid import carry
from omad.output.formats import save_formats
from omad.output.page import page_data
from omad.output.robots.robot import link_frames

NEAR = 1e-3
"""Metres."""
HANDS = ["ordinary", "mirrored"]


@cache
def seen(hand: str) -> tuple[omad.Observation, omad.Estimate]:
    """A cabinet with its door ajar, or its image in a mirror."""
    category = EVERY["cabinet_one_door"]
    view = standard_view(generate(category, 3, "test"), category, (7, 3))
    depth = view.depth[:, ::-1].copy() if hand == "mirrored" else view.depth
    camera = view.camera.K.copy()
    camera[0, 2] = view.camera.width - 1 - camera[0, 2] if hand == "mirrored" else camera[0, 2]
    observation = omad.Observation.from_depth(depth, camera)
    return observation, omad.Estimator.from_pretrained("cabinet_one_door", "cpu")(observation)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    @cache
    def export(hand: str) -> tuple[omad.Estimate, Path]:
        observation, estimate = seen(hand)
        folder = tmp_path_factory.mktemp(hand)
        extras = {"mjcf": "mujoco", "usd": "pxr"}
        formats = [name for name in ("urdf", "mjcf", "usd", "ply", "glb", "ros") if installed(extras.get(name, "json"))]
        save_formats(estimate, observation, folder, formats)
        return estimate, folder

    return export


def apart(estimate: omad.Estimate, found: dict[str, np.ndarray]) -> float:
    """How far vertices of a part at most are from the next of its surface where it is seen."""
    worst = 0.0
    assert set(found) == {part.name for part in estimate.parts}
    for part in estimate.parts:
        there = part.mesh_in_camera.vertices
        off = np.linalg.norm(found[part.name][:, None] - there[None], axis=-1)
        worst = max(worst, off.min(1).max(), off.min(0).max())
    return float(worst)


def test_one_is_mirrored_and_their_fits_move_them():
    assert seen("ordinary")[1].of_other_hand != seen("mirrored")[1].of_other_hand
    for hand in HANDS:
        estimate = seen(hand)[1]
        off = np.abs(estimate.surface.placed.T_camera_part - estimate.T_camera_part)
        assert off.max() > 5 * NEAR  # else nothing would show


@pytest.mark.parametrize("hand", HANDS)
def test_parts_lie_where_the_surface_was_fitted(hand):
    estimate = seen(hand)[1]
    for part, posed in zip(estimate.parts, estimate.surface.posed(), strict=True):
        assert np.allclose(part.mesh.carried(part.T_camera_part).vertices, part.mesh_in_camera.vertices, atol=1e-9)
        assert np.allclose(posed.vertices, part.mesh_in_camera.vertices, atol=1e-9)
    moved = estimate.object_model().posed(estimate.joint_states, estimate.T_camera_base)
    assert apart(estimate, {part.name: mesh.vertices for part, mesh in zip(estimate.parts, moved, strict=True)}) < NEAR


@pytest.mark.parametrize("hand", HANDS)
def test_ply(hand, written):
    estimate, folder = written(hand)
    found = {part.name: _vertices(folder / f"part-{part.name}.ply") for part in estimate.parts}
    assert apart(estimate, found) < NEAR


@pytest.mark.parametrize("hand", HANDS)
def test_urdf_at_the_written_states(hand, written, tmp_path):
    estimate, folder = written(hand)
    estimate.save_urdf(tmp_path / "object.urdf")
    state = json.loads((tmp_path / "state.json").read_text())
    states = json.loads((folder / "robot-joints.json").read_text())
    assert states == pytest.approx(state["joint_states"])
    assert list(states.values()) == pytest.approx([joint["state"] for joint in estimate.to_dict()["joints"]])
    assert np.allclose(state["T_camera_base"], estimate.to_dict()["T_camera_base"])
    for file, T_camera_root in ((folder / "robot.urdf", np.eye(4)), (tmp_path / "object.urdf", state["T_camera_base"])):
        robot = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)
        robot.update_cfg(states)
        found = {}
        for part in estimate.parts:
            [visual] = robot.link_map[part.name].visuals
            in_link = carry(visual.origin, _vertices(file.parent / visual.geometry.mesh.filename))
            found[part.name] = carry(np.asarray(T_camera_root) @ robot.get_transform(part.name), in_link)
        assert apart(estimate, found) < NEAR


@pytest.mark.parametrize("hand", HANDS)
def test_mjcf_at_its_keyframe(hand, written):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra: pip install 'omad[mujoco]'")
    estimate, folder = written(hand)
    model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    found = {}
    for geom in np.flatnonzero(model.geom_group == 2):
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        name = model.body(model.geom_bodyid[geom]).name
        found[name] = vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
    assert apart(estimate, found) < NEAR


@pytest.mark.parametrize("hand", HANDS)
def test_usd(hand, written):
    Usd = pytest.importorskip("pxr.Usd", reason="OpenUSD is an extra: pip install 'omad[usd]'")
    from pxr import UsdGeom

    estimate, folder = written(hand)
    stage, places, found = Usd.Stage.Open(str(folder / "robot.usda")), UsdGeom.XformCache(), {}
    root = stage.GetDefaultPrim()
    for part in estimate.parts:
        mesh = root.GetChild(part.name).GetChild("surface")
        points = np.array(UsdGeom.Mesh(mesh).GetPointsAttr().Get(), float)
        found[part.name] = carry(np.array(places.GetLocalToWorldTransform(mesh)).T, points)
    assert apart(estimate, found) < NEAR


@pytest.mark.parametrize("hand", HANDS)
def test_glb(hand, written):
    estimate, folder = written(hand)
    scene, found = trimesh.load(folder / "object.glb", process=False), {}
    for part in estimate.parts:
        T, geometry = scene.graph[part.name]
        found[part.name] = carry(estimate.T_camera_base @ T, np.asarray(scene.geometry[geometry].vertices))
    assert apart(estimate, found) < NEAR


@pytest.mark.parametrize("hand", HANDS)
def test_ros_carries_the_links_of_the_urdf(hand, written):
    estimate, folder = written(hand)
    told, links = json.loads((folder / "ros.json").read_text()), link_frames(estimate)
    frames = {"camera_optical_frame": np.eye(4)}
    for each in told["tf"]["transforms"]:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat([each["transform"]["rotation"][axis] for axis in "xyzw"]).as_matrix()
        T[:3, 3] = [each["transform"]["translation"][axis] for axis in "xyz"]
        frames[each["child_frame_id"]] = frames[each["header"]["frame_id"]] @ T
    assert np.allclose([frames[part.name] for part in estimate.parts], links)
    assert told["joint_state"]["position"] == pytest.approx(estimate.joint_states)


@pytest.mark.parametrize("hand", HANDS)
def test_the_page_at_its_first_states(hand):
    observation, estimate = seen(hand)
    data = page_data(observation, estimate)
    assert np.allclose(data["T_camera_base"], estimate.T_camera_base)
    places = estimate.object_model().part_transforms(
        np.array([joint["state"] for joint in data["joints"]]), np.array(data["T_camera_base"])
    )
    found = {
        part["name"]: carry(T, np.array(part["canonical_vertices"]))
        for part, T in zip(data["parts"], places, strict=True)
    }
    assert apart(estimate, found) < NEAR


def _vertices(file: Path) -> np.ndarray:
    return np.asarray(trimesh.load(file, process=False).vertices)
