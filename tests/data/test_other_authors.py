"""Models as different people write them: where is rest, what is up and in front, and is it of the category at all?"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.categories import EVERY
from helpers.own_models import Z_UP, box
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.urdf_import.folder import import_model
from omad.geometry.joint_kinds import REVOLUTE
from omad.geometry.kinematics import KinematicTree
from omad.geometry.mesh import Mesh, merge_meshes
from omad.objects.category import JointSpec
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf


def made(name: str, parts: list[Mesh], pivots, limits) -> ObjectModel:
    """An object of a shipped category as its spec asks, at rest; ``limits`` may be wider than those of the spec."""
    category = EVERY[name]
    axes = np.array([joint.axis for joint in category.joints], dtype=float)
    return ObjectModel.of(
        category,
        "made",
        parts=parts,
        axes=axes,
        pivots=np.array(pivots, dtype=float),
        limits=np.array(limits, dtype=float),
        motions=[joint.motion for joint in category.joints],
    ).centred()


def as_file(model: ObjectModel, folder: Path, states, flips=False) -> Path:
    """Its URDF with z up, the zero of its joints at ``states``, its axes perhaps turned round."""
    moved = model.with_zero_at(np.array(states, dtype=float))
    turned = replace(
        moved,
        parts=tuple(part.warped(lambda vertices: vertices @ Z_UP.T + 0.3) for part in moved.parts),
        axes=moved.axes @ Z_UP.T * (-1 if flips else 1),
        pivots=moved.pivots @ Z_UP.T + 0.3,
        limits=-moved.limits[:, ::-1] if flips else moved.limits,
    )
    return write_urdf(turned, folder)


def assert_found(model: ObjectModel, truth: ObjectModel, share: float = 1e-6) -> None:
    """Parts within a share of the diagonal of where they are."""
    np.testing.assert_allclose(model.part_boxes(), truth.part_boxes(), atol=share * truth.diagonal)


def test_a_door_that_is_shut_at_zero_is_so_though_its_limit_lies_beyond(tmp_path):
    body, door = box((-0.3, 0, -0.55), (0.3, 0.6, 0)), box((-0.3, 0.02, 0), (0.3, 0.5, 0.03))
    truth = made("oven", [body, door], [(0, 0.02, 0.01)], [np.radians([-5, 92])])
    model = import_model(as_file(truth, tmp_path, [0]), EVERY["oven"])
    assert_found(model, truth)
    np.testing.assert_allclose(model.limits, [np.radians([0, 90])])


def bin_with_lid(taper: float = 0.0) -> ObjectModel:
    """Without a top; walls in front and behind lean outward by ``taper`` metres."""
    body = box((-0.25, 0, -0.3), (0.25, 0.95, 0.3)).warped(
        lambda v: v + np.outer(v[:, 1] / 0.95, [0, 0, taper]) * np.sign(v[:, 2:])
    )
    open_above = body.vertices[body.faces][:, :, 1].min(1) < 0.9
    lid = box((-0.26, 0.95, -0.4), (0.26, 0.98, 0.4))
    parts = [Mesh(body.vertices, body.faces[open_above]), lid]
    return made("trash_can", parts, [(0, 0.96, -0.41)], [np.radians([0, 270])])


def test_a_lid_that_can_hang_down_behind_is_shut_on_top(tmp_path):
    truth = bin_with_lid()
    model = import_model(as_file(truth, tmp_path, [0], flips=True), EVERY["trash_can"])
    assert_found(model, truth)


def test_a_bin_with_sloping_walls_stands_upright(tmp_path):
    truth = bin_with_lid(taper=0.09)
    model = import_model(as_file(truth, tmp_path, [0]), EVERY["trash_can"])
    assert_found(model, truth)


def test_drawers_may_be_of_any_height_and_stand_on_legs(tmp_path):
    heights = [0.83, 0.78, 0.73, 0.68, 0.3]
    cabinet = [box((-0.34, 0.3, -0.23), (0.34, 0.85, 0.2)), box((-0.34, 0, -0.23), (-0.3, 0.3, 0.2))]
    drawers = [box((-0.33, low, -0.2), (0.33, high, 0.22)) for high, low in zip(heights, heights[1:], strict=False)]
    truth = made("drawer_4", [merge_meshes(cabinet), *drawers], np.zeros((4, 3)), [[0, 0.3]] * 4)
    assert_found(import_model(as_file(truth, tmp_path, [0, 0.1, 0, 0]), EVERY["drawer_4"]), truth)


def test_a_drawer_may_lie_high_up_or_at_the_bottom(tmp_path):
    for index, low in enumerate((0.02, 0.44)):
        frame = [box((-0.2, 0, -0.2), (0.2, 0.6, -0.18)), box((-0.2, 0.58, -0.2), (0.2, 0.6, 0.18))]
        drawer = box((-0.19, low, -0.15), (0.19, low + 0.12, 0.19))
        truth = made("drawer_1", [merge_meshes(frame), drawer], [(0, 0, 0)], [[0, 0.3]])
        assert_found(import_model(as_file(truth, tmp_path / str(index), [0]), EVERY["drawer_1"]), truth)


def test_two_drawers_beside_each_other_are_both_above_the_next(tmp_path):
    ends = [(-0.4, 0.0, 0.8), (0.0, 0.4, 0.8), (-0.4, 0.4, 0.6), (-0.4, 0.4, 0.4), (-0.4, 0.4, 0.2)]
    drawers = [box((low + 0.01, top - 0.18, -0.2), (high - 0.01, top, 0.22)) for low, high, top in ends]
    truth = made("drawer_5", [box((-0.42, 0, -0.21), (0.42, 0.9, 0.2)), *drawers], np.zeros((5, 3)), [[0, 0.3]] * 5)
    model = import_model(as_file(truth, tmp_path, [0] * 5), EVERY["drawer_5"])
    assert_found(replace(model, parts=model.parts[3:]), replace(truth, parts=truth.parts[3:]))


@pytest.mark.parametrize("index", [1, 3, 4, 7])
def test_limits_tell_the_jaws_of_pliers_from_handles_as_slim(index, tmp_path):
    truth = generate(EVERY["pliers"], index)
    model = import_model(as_file(truth, tmp_path, truth.limits.mean(1)), EVERY["pliers"])
    swapped = replace(model, parts=tuple(part.warped(lambda v: v * [-1, -1, 1]) for part in model.parts[::-1]))
    off = [np.abs(each.part_boxes() - truth.part_boxes()).max() for each in (model, swapped)]
    assert min(off) < 0.02 * truth.diagonal


@pytest.mark.parametrize("index", [1, 2, 4, 5])
def test_arms_of_a_lamp_reach_where_they_should_however_the_file_has_them(index, tmp_path):
    truth = generate(EVERY["desk_lamp"], index)
    states = truth.limits @ [0.3, 0.7]
    model = import_model(as_file(truth, tmp_path, states, flips=index % 2 == 0), EVERY["desk_lamp"])
    assert_found(model, truth, 0.03)


@pytest.mark.parametrize("index", [0, 1, 2, 5, 7])
def test_hinges_tell_the_front_of_bent_spectacles(index, tmp_path):
    truth = generate(EVERY["eyeglasses"], index)
    model = import_model(as_file(truth, tmp_path, truth.limits.mean(1), flips=True), EVERY["eyeglasses"])
    assert_found(model, truth, 0.03)


def test_a_lid_that_swings_about_its_middle_is_refused(tmp_path):
    body, lid = box((-0.15, 0, -0.12), (0.15, 0.6, 0.12)), box((-0.14, 0.6, -0.12), (0.14, 0.61, 0.12))
    swing = made("trash_can", [body, lid], [(0, 0.605, 0)], [[-1.2, 1.2]])
    with pytest.raises(InputError, match="its lid turns about its middle, that of a trash_can about one end"):
        import_model(as_file(swing, tmp_path, [0]), EVERY["trash_can"])


def test_what_reaches_nowhere_cannot_be_told_by_it():
    with pytest.raises(ValueError, match="rest: is 'reaching', of a part without a reach; give that, too"):
        JointSpec("neck", "revolute", 0, (1, 0, 0), (-1, 1), rest="reaching")


# Trees that are written otherwise ------------------------------------------------------------------------------------


def hung_from(model: ObjectModel, part: int, names: Sequence[str] = ()) -> ObjectModel:
    """The object with its base hung on one of the parts that moved on it, and that as the root of the tree."""
    order = [part, 0, *(other for other in range(1, len(model.parts)) if other != part)]
    joints = [part - 1, *(other - 1 for other in order[2:])]
    signs = np.array([[-1.0], *[[1.0]] * (len(joints) - 1)])
    motions = tuple(model.tree.motions[joint] for joint in joints)
    return replace(
        model,
        part_names=tuple(names or (f"link_{index}" for index in range(len(order)))),
        parts=tuple(model.parts[index] for index in order),
        joint_names=tuple(f"joint_{joint}" for joint in joints),
        tree=KinematicTree((0, *[1] * (len(joints) - 1)), motions),
        axes=model.axes[joints] * signs,
        pivots=model.pivots[joints],
        limits=model.limits[joints],
    )


@pytest.mark.parametrize(
    "name", ["dishwasher", "eyeglasses", "drawer", "cabinet_two_doors", "refrigerator", "trash_can"]
)
def test_a_tree_may_begin_at_the_door(name, tmp_path):
    truth = generate(EVERY[name], 0)
    as_usual = import_model(as_file(truth, tmp_path / "usual", truth.limits.mean(1)), EVERY[name])
    turned = hung_from(truth.with_zero_at(truth.limits.mean(1)), 1)
    turned = replace(turned, parts=tuple(part.warped(lambda v: v @ Z_UP.T + 0.3) for part in turned.parts))
    turned = replace(turned, axes=turned.axes @ Z_UP.T, pivots=turned.pivots @ Z_UP.T + 0.3)
    assert_found(import_model(write_urdf(turned, tmp_path / "turned"), EVERY[name]), as_usual)


def test_a_part_called_like_the_category_is_not_taken_for_one_of_a_name_inside_of_that(tmp_path):
    """No top in laptop_chassis."""
    base, screen = box((-0.17, 0, 0), (0.17, 0.018, 0.24)), box((-0.17, 0.018, -0.008), (0.17, 0.25, 0))
    truth = made("laptop", [base, screen], [(0, 0.018, 0)], [np.radians([-45, 85])])
    turned = hung_from(truth, 1, ["laptop_screen", "laptop_chassis"])
    assert_found(import_model(write_urdf(turned, tmp_path), EVERY["laptop"]), truth)


def test_halves_that_turn_on_a_screw_between_them_turn_on_each_other(tmp_path):
    truth = generate(EVERY["scissors"], 0)
    model = truth.with_zero_at(truth.limits[:, 0])
    screw = box(model.pivots[0] - 0.003, model.pivots[0] + 0.003)
    width = np.ptp(truth.limits[0])
    on_screw = replace(
        model,
        part_names=("link_0", "link_1", "link_2"),
        parts=(screw, *model.parts),
        joint_names=("one", "other"),
        tree=KinematicTree((0, 0), (REVOLUTE, REVOLUTE)),
        axes=model.axes[[0, 0]],
        pivots=model.pivots[[0, 0]],
        limits=np.array([[-width / 2, 0], [0, width / 2]]),
    )
    found = import_model(write_urdf(on_screw, tmp_path), EVERY["scissors"])
    np.testing.assert_allclose(found.limits, truth.limits, atol=1e-6)


def test_what_turns_about_its_own_middle_is_not_taken_for_the_door(tmp_path):
    truth = generate(EVERY["microwave"], 0)
    size = np.ptp(truth.part_boxes()[1], axis=0)[0] / 2
    plate = box((-size, -0.01, -size), (size, 0, size))
    with_plate = replace(
        truth,
        part_names=("link_0", "link_1", "link_2"),
        parts=(*truth.parts, plate),
        joint_names=("joint_0", "joint_1"),
        tree=KinematicTree((0, 0), (REVOLUTE, REVOLUTE)),
        axes=np.concatenate([truth.axes, [[0, 1, 0]]]),
        pivots=np.concatenate([truth.pivots, [[0, 0, 0]]]),
        limits=np.concatenate([truth.limits, [[-3, 3]]]),
    )
    model = import_model(write_urdf(with_plate, tmp_path), EVERY["microwave"])
    np.testing.assert_allclose(np.ptp(model.part_boxes()[1], axis=0), np.ptp(truth.part_boxes()[1], axis=0), atol=1e-6)


def test_a_lid_may_hang_on_the_magazine(tmp_path):
    lows, highs = [(0.0, 0.0), (0.03, 0.0), (0.02, 0.0)], [(0.01, 0.15), (0.05, 0.14), (0.03, 0.13)]
    ends = zip((0.015, 0.015, 0.01), lows, highs, strict=True)
    base, lid, magazine = (box((-w, *low), (w, *high)) for w, low, high in ends)
    pivots, limits = [(0, 0.025, 0)] * 2, np.radians([[0, 90], [0, 50]])
    truth = made("stapler", [base, lid, magazine], pivots, limits)
    chain = replace(
        made("stapler", [base, magazine, lid], pivots, np.radians([[0, 40], [0, 50]])),
        part_names=("link_0", "link_1", "link_2"),
        axes=truth.axes[[0, 0]],
    )
    model = import_model(write_urdf(chain, tmp_path), EVERY["stapler"])
    assert_found(model, truth)
    np.testing.assert_allclose(model.limits, truth.limits, atol=1e-6)


def test_a_chest_of_two_columns_stands_though_it_is_wide(tmp_path):
    ends = [(x, y) for y in (0.35, 0.05) for x in (-0.4, 0.01)]
    drawers = [box((x, y, -0.2), (x + 0.39, y + 0.28, 0.22)) for x, y in ends]
    truth = made("drawer_4", [box((-0.42, -0.15, -0.2), (0.42, 0.65, 0.2)), *drawers], np.zeros((4, 3)), [[0, 0.3]] * 4)
    model = import_model(as_file(truth, tmp_path, [0.3, 0.3, 0, 0]), EVERY["drawer_4"])
    np.testing.assert_allclose(model.part_boxes()[0], truth.part_boxes()[0], atol=1e-6)
    assert (model.part_boxes()[1:3, 0, 1] > model.part_boxes()[3:, 1, 1]).all()


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_what_moves_freely_in_the_world_stands_in_it(kind, tmp_path):
    truth = generate(EVERY["oven"], 0)
    file = write_urdf(truth, tmp_path)
    free = f'<joint name="free" type="{kind}"><parent link="world"/><child link="body"/></joint>'
    file.write_text(file.read_text().replace("</robot>", f'<link name="world"/>{free}</robot>'))
    assert_found(import_model(file, EVERY["oven"]), truth)
    file.write_text(
        file.read_text().replace('link="world"', 'link="door"').replace('child link="body"', 'child link="world"')
    )
    with pytest.raises(InputError, match=f"joint 'free' has the type '{kind}'; give revolute"):
        import_model(file, EVERY["oven"])


def test_of_a_tree_that_begins_at_a_drawer_what_is_wrong_with_it_is_said(tmp_path):
    chest = generate(EVERY["drawer"], 0)
    file = write_urdf(hung_from(replace(chest, limits=chest.limits * 0.02), 1), tmp_path)
    with pytest.raises(InputError, match=r"joint 'joint_0' moves 0 to 0.003.* m from its rest state"):
        import_model(file, EVERY["drawer"])
