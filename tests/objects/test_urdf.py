"""URDF in and out, judged by yourdfpy's own kinematics, and every way a file can be broken."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
from scipy.spatial.transform import Rotation

from helpers.categories import CATEGORIES
from helpers.kinematics_by_yourdfpy import largest_gap, vertices_of
from helpers.own_models import JAR_PITCH, jar
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.urdf_import.articulation import RawArticulation, read_articulation, read_urdf
from omad.geometry.joint_kinds import motion_of
from omad.geometry.kinematics import KinematicTree
from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import Category, JointSpec, PartSpec
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf

MODELS = Path(os.environ.get("OMAD_MODELS", "nowhere"))
needs_models = pytest.mark.skipif(not MODELS.is_dir(), reason="OMAD_MODELS names no folder of real models")

CHAIN = Category(
    name="gadget",
    metres_per_unit=0.5,
    parts=tuple(PartSpec(name, 2) for name in ("body", "first arm", "slide.a", "tip", "side")),
    joints=(
        JointSpec("j0", "revolute", 0, (1.0, 0.0, 0.0), (-1.0, 1.0)),
        JointSpec("j1", "prismatic", 1, (0.0, 1.0, 0.0), (0.0, 1.0)),
        JointSpec("j2", "revolute", 2, (0.0, 0.0, 1.0), (-1.0, 1.0)),
        JointSpec("j3", "revolute", 0, (0.0, 1.0, 0.0), (-1.0, 1.0)),
    ),
)


def random_gadget(seed: int = 0) -> ObjectModel:
    """A tree four joints deep with mixed joints in general position."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(4, 3))
    limits = np.sort(rng.uniform(-2, 2, (4, 2)), axis=1)
    kinds = np.array(CHAIN.turning)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    return ObjectModel(
        name="gadget.v1.2 & co",
        category=CHAIN.name,
        part_names=tuple(part.name for part in CHAIN.parts),
        parts=tuple(Mesh(rng.normal(size=(4, 3)), faces) for _ in CHAIN.parts),
        joint_names=tuple(joint.name for joint in CHAIN.joints),
        tree=CHAIN.tree,
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        pivots=rng.normal(size=(4, 3)) * kinds[:, None],
        limits=limits,
    )


def random_states(model: ObjectModel, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(model.limits[:, 0], model.limits[:, 1])


MADE = [random_gadget(), *(generate(category, 3) for category in CATEGORIES.values())]


@pytest.mark.parametrize("model", MADE, ids=lambda model: model.category)
def test_what_was_written_is_read_back_exactly(model, tmp_path):
    category = CATEGORIES.get(model.category, CHAIN)
    file = write_urdf(model, tmp_path / "a.b c")
    back = read_urdf(file, category)
    assert back.name == model.name
    assert back.part_names == model.part_names
    assert back.joint_names == model.joint_names
    assert back.tree == model.tree
    for field in ("axes", "pivots", "limits"):
        np.testing.assert_allclose(getattr(back, field), getattr(model, field), atol=1e-12)
    for ours, theirs in zip(back.parts, model.parts, strict=True):
        np.testing.assert_allclose(ours.vertices, theirs.vertices, atol=1e-9)
        np.testing.assert_array_equal(ours.faces, theirs.faces)
    states = random_states(model, 5)
    for ours, theirs in zip(back.posed_vertices(states), model.posed_vertices(states), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("model", MADE, ids=lambda model: model.category)
def test_another_reader_moves_our_files_as_we_do(model, tmp_path):
    robot = yourdfpy.URDF.load(str(write_urdf(model, tmp_path)))
    assert robot.validate(), robot.errors
    assert robot.actuated_joint_names == list(model.joint_names)
    for seed in range(5):
        states = random_states(model, seed)
        robot.update_cfg(dict(zip(model.joint_names, states, strict=True)))
        for name, ours in zip(model.part_names, model.posed_vertices(states), strict=True):
            assert largest_gap(vertices_of(robot, name), ours) < 1e-6 * model.diagonal


def test_strict_parsers_find_every_attribute_of_a_limit(tmp_path):
    robot = yourdfpy.URDF.load(str(write_urdf(MADE[0], tmp_path)), load_meshes=False).robot
    for joint in robot.joints:
        assert None not in (joint.limit.effort, joint.limit.velocity, joint.limit.lower, joint.limit.upper)


def test_models_share_a_folder_and_leave_nothing_else_behind(tmp_path):
    first, second = write_urdf(MADE[1], tmp_path / "one.urdf"), write_urdf(MADE[2], tmp_path / "two.urdf")
    assert read_urdf(first, CATEGORIES[MADE[1].category]).name == MADE[1].name
    assert read_urdf(second, CATEGORIES[MADE[2].category]).name == MADE[2].name
    assert not [file for file in tmp_path.rglob("*") if "part" in file.suffix]
    assert {file.suffix for file in tmp_path.rglob("*") if file.is_file()} == {".urdf", ".obj"}


def test_reading_with_another_category_is_refused(tmp_path):
    file = write_urdf(MADE[0], tmp_path)
    with pytest.raises(InputError, match=r"\.urdf: .*laptop"):
        read_urdf(file, CATEGORIES["laptop"])
    other = replace(CHAIN, joints=(replace(CHAIN.joints[0], type="prismatic"), *CHAIN.joints[1:]))
    with pytest.raises(InputError, match=r"\.urdf: "):
        read_urdf(file, other)


# Foreign files -------------------------------------------------------------------------------------------------------

BOX = '<visual><origin xyz="0 0 1" rpy="0 0 0"/><geometry><box size="1 2 3"/></geometry></visual>'


def link(name: str, inside: str = BOX) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def robot_file(folder: Path, *elements: str) -> Path:
    file = folder / "robot.urdf"
    file.write_text('<robot name="r">' + "".join(elements) + "</robot>")
    return file


def read(folder: Path, *elements: str, **options) -> RawArticulation:
    return read_articulation(robot_file(folder, *elements), **options)


def test_joints_are_given_in_the_model_frame(tmp_path):
    raw = read(
        tmp_path,
        link("a"),
        link("b"),
        link("c"),
        joint("ab", "a", "b", "fixed", '<origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>'),
        joint("bc", "b", "c", "prismatic", '<origin xyz="1 0 0"/><axis xyz="2 0 0"/><limit lower="-1" upper="2"/>'),
        metres_per_unit=0.5,
    )
    assert [part.names for part in raw.links] == [("a", "b"), ("c",)]
    (only,) = raw.joints
    np.testing.assert_allclose(only.axis, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(only.pivot, [0.5, 0.5, 0], atol=1e-12)
    assert only.limits == (-0.5, 1.0)
    np.testing.assert_allclose(raw.links[1].mesh.vertices.mean(0), [0.5, 0.5, 0.5], atol=1e-12)


def test_continuous_joints_become_revolute_and_empty_links_vanish(tmp_path):
    raw = read(
        tmp_path,
        link("world", ""),
        link("a"),
        link("b"),
        link("tool frame", ""),
        joint("wa", "world", "a", "prismatic"),
        joint("ab", "a", "b", "continuous", '<axis xyz="0 0 1"/><limit effort="1" velocity="1"/>'),
        joint("bt", "b", "tool frame", "revolute"),
    )
    assert [part.name for part in raw.links] == ["a", "b"]
    assert [(j.type, j.parent, j.child, j.limits) for j in raw.joints] == [("revolute", 0, 1, None)]


def test_hanging_up_at_another_link_moves_the_same(tmp_path):
    turned = '<origin xyz="1 2 3" rpy="1 2 3"/><axis xyz="1 1 0"/>'
    raw = read(
        tmp_path,
        *(link(name) for name in "abcd"),
        joint("ab", "a", "b", inside=turned),
        joint("bc", "b", "c", "prismatic", turned),
        joint("bd", "b", "d", inside=turned),
    )
    again = raw.rerooted(2)
    assert [part.name for part in again.links] == ["c", "b", "a", "d"]
    states = {"ab": 0.3, "bc": -0.7, "bd": 1.1}

    def relative(articulation: RawArticulation) -> dict[str, np.ndarray]:
        T = [np.eye(4)]
        for j in articulation.joints:
            F = np.eye(4)
            if j.type == "revolute":
                F[:3, :3] = Rotation.from_rotvec(states[j.name] * j.axis).as_matrix()
                F[:3, 3] = j.pivot - F[:3, :3] @ j.pivot
            else:
                F[:3, 3] = states[j.name] * j.axis
            T.append(T[j.parent] @ F)
        by_name = {part.name: T[i] for i, part in enumerate(articulation.links)}
        return {name: np.linalg.inv(by_name["c"]) @ by_name[name] for name in by_name}

    before, after = relative(raw), relative(again)
    for name in "abcd":
        np.testing.assert_allclose(after[name], before[name], atol=1e-12)


def test_meshes_are_found_scaled_and_mirrored(tmp_path):
    (tmp_path / "meshes.d").mkdir()
    (tmp_path / "meshes.d" / "a.b.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1 4/1/1\nf -4//1 -3//1 -2//1\n"
    )
    mesh = '<visual><geometry><mesh filename="package://robot/meshes.d/a.b.obj" scale="2 2 -2"/></geometry></visual>'
    raw = read(tmp_path, link("a", mesh * 2))
    assert raw.links[0].mesh.vertices.shape == (8, 3)
    assert raw.links[0].mesh.faces[:3].tolist() == [[2, 1, 0], [3, 2, 0], [2, 1, 0]]
    assert raw.links[0].mesh.vertices.max() == 2


def test_primitives_are_meshed(tmp_path):
    shapes = '<cylinder radius="1" length="4"/>', '<sphere radius="2"/>', '<box size="1 2 3"/>'
    for shape, extents in zip(shapes, ([2, 2, 4], [4, 4, 4], [1, 2, 3]), strict=True):
        raw = read(tmp_path, link("a", f"<collision><geometry>{shape}</geometry></collision>"))
        np.testing.assert_allclose(np.ptp(raw.links[0].mesh.vertices, axis=0), extents, rtol=0.02)


BAD = {
    "two roots": ([link("a"), link("b")], "a, b"),
    "cycle": (
        [link("r"), link("a"), link("b"), joint("ab", "a", "b"), joint("ba", "b", "a")],
        "'a'",
    ),
    "all in a cycle": ([link("a"), link("b"), joint("ab", "a", "b"), joint("ba", "b", "a")], ""),
    "two parents": (
        [link("a"), link("b"), link("c"), joint("ac", "a", "c"), joint("bc", "b", "c"), joint("ab", "a", "b")],
        "'c'",
    ),
    "type": ([link("a"), link("b"), joint("bend", "a", "b", "flexible")], "'bend'.*'flexible'"),
    "no type": ([link("a"), link("b"), '<joint name="j"><parent link="a"/><child link="b"/></joint>'], "'j'"),
    "dangling": ([link("a"), joint("ab", "a", "b")], "'b'"),
    "twice": ([link("a"), link("a")], "'a'"),
    "joint twice": (
        [link("a"), link("b"), link("c"), joint("j", "a", "b"), joint("j", "a", "c")],
        "'j'",
    ),
    "no child": ([link("a"), '<joint name="j" type="fixed"><parent link="a"/></joint>'], ""),
    "zero axis": ([link("a"), link("b"), joint("j", "a", "b", inside='<axis xyz="0 0 0"/>')], "'j'"),
    "words for numbers": (
        [link("a"), link("b"), joint("j", "a", "b", inside='<origin xyz="up"/>')],
        "",
    ),
    "a limit that is no number": (
        [link("a"), link("b"), joint("j", "a", "b", inside='<limit lower="0" upper="nan"/>')],
        "limits.*'j'",
    ),
    "nothing": ([], ""),
    "no geometry": ([link("a", "")], ""),
    "missing mesh": (
        [link("a", '<visual><geometry><mesh filename="lost/lid.obj"/></geometry></visual>')],
        "'lost/lid.obj'.*'a'",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_broken_files_are_named_in_one_line(case, tmp_path):
    elements, named = BAD[case]
    with pytest.raises(InputError, match=rf"robot\.urdf: .*{named}") as caught:
        read(tmp_path, *elements)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["<robot name='r'><link name='a'>", "", "<html/>"])
def test_files_that_are_no_urdf(text, tmp_path):
    file = tmp_path / "x.urdf"
    file.write_text(text)
    with pytest.raises(InputError, match=r"x\.urdf: "):
        read_articulation(file)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"gone\.urdf: "):
        read_articulation(tmp_path / "gone.urdf")


def test_missing_meshes_can_be_skipped(tmp_path):
    lost = '<visual><geometry><mesh filename="lost.obj"/></geometry></visual>'
    raw = read(tmp_path, link("a", BOX + lost), missing_meshes="skip")
    assert len(raw.links[0].mesh.faces) == 12


@pytest.mark.parametrize("text", ["v 0 0 0\nf 1 2 3\n", "v a b c\n", "v nan 0 0\nv 0 0 1\nv 1 0 0\nf 1 2 3\n"])
def test_broken_meshes_are_named(text, tmp_path):
    (tmp_path / "bad.obj").write_text(text)
    with pytest.raises(InputError, match=r"bad\.obj"):
        read(tmp_path, link("a", '<visual><geometry><mesh filename="bad.obj"/></geometry></visual>'))


def test_merging_keeps_faces_on_their_vertices():
    triangle = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    merged = merge_meshes([triangle, triangle])
    assert merged.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert merge_meshes([]).faces.shape == (0, 3)


@pytest.mark.slow
@needs_models
@pytest.mark.parametrize("name", ["laptop/arctic/laptop.urdf", "stapler/103100/mobility.urdf"])
def test_real_files_move_as_another_reader_moves_them(name):
    raw = read_articulation(MODELS / name)
    robot = yourdfpy.URDF.load(str(MODELS / name))
    tree = KinematicTree(tuple(j.parent for j in raw.joints), tuple(motion_of(j.type) for j in raw.joints))
    model = ObjectModel(
        name=raw.name,
        category="any",
        part_names=tuple(part.name for part in raw.links),
        parts=tuple(part.mesh for part in raw.links),
        joint_names=tuple(j.name for j in raw.joints),
        tree=tree,
        axes=np.stack([j.axis for j in raw.joints]),
        pivots=np.stack([j.pivot for j in raw.joints]),
        limits=np.array([j.limits for j in raw.joints]),
    )
    for seed in range(3):
        states = random_states(model, seed)
        robot.update_cfg(dict(zip(model.joint_names, states, strict=True)))
        for part, ours in zip(model.part_names, model.posed_vertices(states), strict=True):
            assert largest_gap(vertices_of(robot, part), ours) < 1e-6 * model.diagonal


@pytest.mark.parametrize("pitch", [JAR_PITCH, -JAR_PITCH])
def test_a_screw_of_either_hand_has_limits_in_order_and_goes_its_way(pitch, tmp_path):
    model = replace(jar(), tree=KinematicTree((0,), (motion_of("screw", pitch),)))
    robot = yourdfpy.URDF.load(str(write_urdf(model, tmp_path / "jar.urdf")))
    for joint in robot.robot.joints:
        assert joint.limit.lower < joint.limit.upper
    robot.update_cfg({"lid_joint": 2 * np.pi})
    assert robot.get_transform("lid", "jar")[1, 3] == pytest.approx(pitch + model.pivots[0, 1])
    [slide] = [joint.limit for joint in robot.robot.joints if joint.type == "prismatic"]
    assert (slide.lower, slide.upper) == pytest.approx(tuple(sorted((0.0, 1.5 * pitch))))
