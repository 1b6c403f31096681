"""Foreign models: whatever their frame, zero state, names and extra links, the same canonical object comes out."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.categories import CATEGORIES, CHEST, DISHWASHER, EVERY, LAPTOP
from helpers.kinematics_by_yourdfpy import largest_gap
from helpers.one_joint import box_link, edited, extra_joint, plain_dishwasher, plain_laptop
from helpers.own_models import box
from helpers.same_models import assert_same
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.urdf_import.articulation import read_articulation, read_urdf
from omad.data.urdf_import.folder import import_model, load_folder, object_paths
from omad.data.urdf_import.links import label_parts
from omad.data.urdf_import.rest_states import RULES, rest_state
from omad.geometry.joint_kinds import Motion
from omad.geometry.mesh import Mesh
from omad.objects.category import RestRule
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf


def seen_otherwise(model: ObjectModel, seed: int, flip: bool = False, zero: float | None = None) -> ObjectModel:
    """The same one-joint object in another frame, its zero moved, its axis perhaps reversed."""
    rng = np.random.default_rng(seed)
    states = rng.uniform(model.limits[:, 0], model.limits[:, 1]) if zero is None else np.array([zero])
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    sign = -1 if flip else 1
    limits = model.limits - states[:, None]
    return replace(
        model,
        parts=tuple(Mesh(v @ R.T + t, p.faces) for v, p in zip(model.posed_vertices(states), model.parts, strict=True)),
        axes=sign * model.axes @ R.T,
        pivots=(model.pivots + rng.uniform(-1, 1) * model.axes) @ R.T + t,
        limits=-limits[:, ::-1] if flip else limits,
    )


def without_limits(root) -> None:
    for joint in root.iter("joint"):
        joint.set("type", "continuous")
        joint.remove(joint.find("limit"))


def renamed(names: dict[str, str]):
    def change(root) -> None:
        for element in root.iter():
            for key in ("name", "link"):
                if element.get(key) in names:
                    element.set(key, names[element.get(key)])

    return change


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("make", [plain_laptop, plain_dishwasher])
def test_frame_zero_and_sign_of_a_model_do_not_matter(make, seed, flip, tmp_path):
    truth = make()
    file = write_urdf(seen_otherwise(truth, seed, flip), tmp_path)
    assert_same(import_model(file, CATEGORIES[truth.category]), truth, 1e-9, 1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_rest_state_is_found_without_limits(seed, tmp_path):
    for truth in (plain_laptop(), plain_dishwasher()):
        file = edited(write_urdf(seen_otherwise(truth, seed), tmp_path / truth.category), without_limits)
        assert_same(import_model(file, CATEGORIES[truth.category]), truth, 1e-9, 1e-9)


# the shape of a chest of drawers does not say which way is up, so it is not among these
@pytest.mark.slow
@pytest.mark.parametrize("category", [LAPTOP, DISHWASHER], ids=lambda category: category.name)
def test_objects_of_all_shapes_come_back(category, tmp_path):
    """Hollow, bevelled, with handles, racks, wedges. A wedge's own direction is ambiguous by its slope."""
    for index in range(12):
        truth = generate(category, index, "test")
        file = write_urdf(seen_otherwise(truth, index, flip=index % 2 == 0), tmp_path / str(index))
        imported = import_model(file, category)
        assert_same(imported, truth, 0.01 * truth.diagonal, np.radians(2))


def test_links_are_told_apart_by_name_even_where_the_root_is_the_lid(tmp_path):
    truth = plain_laptop()
    other = seen_otherwise(truth, 0)
    turned = replace(
        other, part_names=("screen", "base"), parts=other.parts[::-1], axes=-other.axes, joint_names=("hinge.1",)
    )
    assert_same(import_model(write_urdf(turned, tmp_path), LAPTOP), truth, 1e-9, 1e-9)


def test_unnamed_links_are_told_apart_by_structure(tmp_path):
    truth = plain_dishwasher()
    file = edited(write_urdf(truth, tmp_path), renamed({"body": "link_0", "door": "link_1"}))
    assert_same(import_model(file, DISHWASHER), truth, 1e-9, 1e-9)


def test_a_shape_whose_origin_is_no_number_is_refused(tmp_path):
    file = write_urdf(plain_laptop(), tmp_path / "laptop.urdf")
    file.write_text(file.read_text().replace('xyz="0.0 0.0 0.0"', 'xyz="nan"', 1))
    with pytest.raises(InputError, match=r"laptop\.urdf: link .* no proper origin"):
        read_articulation(file)


def test_extra_links_are_folded_into_what_carries_them(tmp_path):
    plain = plain_dishwasher()
    low, high = np.array([-0.02, 0.2, 0.275]), np.array([0.02, 0.24, 0.285])

    def change(root) -> None:
        box_link(root, "rack", (-0.1, 0.0, -0.2), (0.1, 0.05, 0.1))
        extra_joint(root, "slide", "body", "rack", "prismatic", lower="-0.1", upper="-0.05")
        box_link(root, "knob", low - plain.pivots[0], high - plain.pivots[0])
        extra_joint(root, "turn", "door", "knob", "continuous")

    model = import_model(edited(write_urdf(plain, tmp_path), change), DISHWASHER)
    # the rack's joint does not allow zero: it stands where it comes nearest
    extras = box((-0.1, 0.0, -0.25), (0.1, 0.05, 0.05)), box(low, high)
    for part, with_extra, extra in zip(plain.parts, model.parts, extras, strict=True):
        assert len(with_extra.faces) == 24
        assert largest_gap(np.concatenate([part.vertices, extra.vertices]), with_extra.vertices) < 1e-9


def test_partnet_folders_are_brought_to_metres_and_named_by_their_semantics(tmp_path):
    folder = tmp_path / "11.7.a"
    truth = plain_dishwasher()
    unit = DISHWASHER.metres_per_unit
    normalised = replace(
        seen_otherwise(truth, 1, zero=0.0),
        parts=tuple(Mesh(p.vertices / unit, p.faces) for p in seen_otherwise(truth, 1, zero=0.0).parts),
        pivots=seen_otherwise(truth, 1, zero=0.0).pivots / unit,
    )
    file = edited(write_urdf(normalised, folder / "mobility.urdf"), renamed({"body": "link_1", "door": "link_0"}))
    (folder / "semantics.txt").write_text("link_0 hinge rotation_door\nlink_1 heavy dishwasher_body\n\nodd line\n")
    imported = import_model(folder, DISHWASHER)
    assert imported.name == import_model(file, DISHWASHER).name == "11.7.a"
    assert_same(imported, truth, 1e-9, 1e-9)
    assert import_model(folder, DISHWASHER, scale=2 * unit).diagonal == pytest.approx(2 * truth.diagonal)
    (folder / "semantics.txt").unlink()
    assert_same(import_model(folder, DISHWASHER), truth, 1e-9, 1e-9)


def test_missing_limits_come_from_the_spec_and_wide_ones_are_kept_within_it(tmp_path):
    wide = replace(plain_laptop(), limits=np.array([[-1.5, 1.57]]))
    for change in (lambda root: None, without_limits):
        model = import_model(edited(write_urdf(wide, tmp_path), change), LAPTOP)
        np.testing.assert_allclose(model.limits, [LAPTOP.joints[0].limits])


@pytest.mark.parametrize(("left_out", "limits"), [("lower", (0.0, 1.57)), ("upper", (-1.5, 0.0))])
def test_a_limit_that_is_left_out_is_zero_as_urdf_has_it(left_out, limits, tmp_path):
    wide = replace(plain_laptop(), limits=np.array([[-1.5, 1.57]]))
    file = edited(write_urdf(wide, tmp_path), lambda root: root.find("joint/limit").attrib.pop(left_out))
    assert read_articulation(file).joints[0].limits == limits


@pytest.mark.parametrize("up", [0, 1, 2], ids="xyz".__getitem__)
def test_a_right_hinged_door_is_not_taken_for_a_left_hinged_one_on_its_head(up, tmp_path):
    category, R = EVERY["microwave"], np.roll(np.eye(3), up - 1, axis=0)
    for name, model in (("left", generate(category, 0)), ("right", generate(category, 0).mirrored())):
        parts = tuple(part.warped(lambda vertices: vertices @ R.T) for part in model.parts)
        turned = replace(model, parts=parts, axes=model.axes @ R.T, pivots=model.pivots @ R.T)
        found = import_model(write_urdf(turned, tmp_path / name), category)
        assert found.of_other_hand == (name == "right")


def test_objects_may_be_files_and_folders_side_by_side(tmp_path):
    write_urdf(plain_laptop(), tmp_path / "one")
    write_urdf(plain_laptop(), tmp_path / "packed" / "urdf")
    file = write_urdf(plain_laptop(), tmp_path)
    (tmp_path / "textures").mkdir()
    assert object_paths(tmp_path) == [file, tmp_path / "one", tmp_path / "packed"]


def test_imported_models_survive_our_own_writer(tmp_path):
    model = import_model(write_urdf(seen_otherwise(generate(DISHWASHER, 5), 2), tmp_path / "a"), DISHWASHER)
    assert_same(read_urdf(write_urdf(model, tmp_path / "b"), DISHWASHER), model, 1e-9, 1e-12)
    assert_same(import_model(tmp_path / "b" / "model.urdf", DISHWASHER), model, 1e-9, 1e-9)


# A category of the user's own ----------------------------------------------------------------------------------------


def test_alike_parts_are_put_in_order_by_where_they_lie(tmp_path):
    drawers = [box((-0.2, y, -0.19), (0.2, y + 0.2, 0.21)) for y in (0.5, 0.27, 0.04)]
    truth = ObjectModel(
        name="made",
        category="chest",
        part_names=tuple(part.name for part in CHEST.parts),
        parts=(box((-0.22, 0, -0.2), (0.22, 0.72, 0.2)), *drawers),
        joint_names=tuple(joint.name for joint in CHEST.joints),
        tree=CHEST.tree,
        axes=np.tile([0.0, 0.0, 1.0], (3, 1)),
        pivots=np.zeros((3, 3)),
        limits=np.tile([0.0, 0.3], (3, 1)),
    ).centred()
    R = Rotation.from_euler("xz", [90, 30], degrees=True).as_matrix()  # z up; the look of a chest does not tell
    turned = [Mesh(truth.parts[k].vertices @ R.T, truth.parts[k].faces) for k in (0, 3, 1, 2)]
    shuffled = replace(truth, parts=tuple(turned), axes=truth.axes @ R.T)
    assert_same(import_model(write_urdf(shuffled, tmp_path), CHEST), truth, 1e-9, 1e-9)

    def fourth(root) -> None:
        box_link(root, "drawer 9", (-0.2, 0.0, -0.19), (0.2, 0.2, 0.21))
        extra_joint(root, "slide 9", "frame", "drawer 9", "prismatic", lower="0", upper="0.3")

    with pytest.raises(InputError, match="chest"):
        import_model(edited(write_urdf(shuffled, tmp_path), fourth), CHEST)

    def keys(root) -> None:
        for key in range(60):
            box_link(root, f"key {key}", (-0.2, 0.0, -0.19), (0.2, 0.2, 0.21))
            extra_joint(root, f"press {key}", "frame", f"key {key}", "prismatic", lower="0", upper="0.3")

    with pytest.raises(InputError, match=r"in \d+ ways"):
        import_model(edited(write_urdf(shuffled, tmp_path), keys), CHEST)


# Refusals ------------------------------------------------------------------------------------------------------------


def second_door(root) -> None:
    box_link(root, "door_2", (-0.3, -0.3, 0.27), (0.3, 0.3, 0.3))
    extra_joint(root, "hinge_2", "body", "door_2", "revolute", lower="0", upper="1.5")


def sliding_door(root) -> None:
    root.find("joint").set("type", "prismatic")


def stuck_door(root) -> None:
    root.find("joint/limit").set("upper", "0.01")


def no_joint(root) -> None:
    root.remove(root.find("joint"))
    root.remove(root.findall("link")[1])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (second_door, "door"),
        (sliding_door, "revolute"),
        (stuck_door, "joint 'door_hinge' moves 0° to 1° from its rest state, that of a dishwasher 0° to 90°"),
        (no_joint, "revolute"),
    ],
)
def test_objects_that_do_not_fit_are_refused_in_one_line(change, named, tmp_path):
    edited(write_urdf(plain_dishwasher(), tmp_path), change)
    with pytest.raises(InputError, match=named) as caught:
        import_model(tmp_path, DISHWASHER)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def knobs_alone(root) -> None:
    renamed({"door": "knob_0"})(root)
    extra_joint(root, "second", "body", "knob_1", "continuous")
    box_link(root, "knob_1", (0.2, 0.1, 0), (0.22, 0.12, 0.03))


def test_what_is_to_be_handled_is_no_door(tmp_path):
    """But where the spec calls a part so."""
    file = write_urdf(plain_dishwasher(), tmp_path)
    knobs = edited(file, knobs_alone)
    with pytest.raises(InputError, match=r"has no door: it has 'knob_0', 'knob_1' instead; .*aliases") as refusal:
        import_model(knobs, DISHWASHER)
    assert "equally" not in str(refusal.value)
    body, door = DISHWASHER.parts
    with_knob = replace(DISHWASHER, parts=(body, replace(door, aliases=("knob_0",))))
    assert_same(import_model(knobs, with_knob), import_model(file, with_knob), 1e-9, 1e-9)


def test_who_gave_a_category_with_too_few_parts_is_told_which_fits(tmp_path):
    two_doors, drawers = generate(EVERY["refrigerator_two_doors"], 0), generate(EVERY["drawer_5"], 0)
    for model, name in ((two_doors, "refrigerator"), (drawers, "drawer")):
        file = write_urdf(model, tmp_path / name)
        with pytest.raises(InputError, match=f"equally well; .* it fits --category {model.category}"):
            import_model(file, EVERY[name])
        assert import_model(file, EVERY[model.category]).category == model.category


def test_a_folder_gives_models_and_reasons(tmp_path):
    for name in ("2", "10.5", "1"):
        write_urdf(seen_otherwise(plain_dishwasher(), 3), tmp_path / name)
    edited(tmp_path / "2" / "model.urdf", sliding_door)
    (tmp_path / "notes").mkdir()
    (tmp_path / ".cache").mkdir()
    (tmp_path / "README").write_text("mine")
    write_urdf(plain_dishwasher(), tmp_path / "3" / "a.urdf")
    write_urdf(plain_dishwasher(), tmp_path / "3" / "b.urdf")
    result = load_folder(tmp_path, DISHWASHER)
    assert [model.name for model in result.models] == ["1", "10.5"]
    assert [refusal.name for refusal in result.refused] == ["2", "3", "notes"]
    for refusal, words in zip(result.refused, ("revolute", "keep one", "add one"), strict=True):
        assert words in refusal.reason
        assert "\n" not in refusal.reason


def test_a_folder_may_be_one_object_or_hold_urdf_files(tmp_path):
    write_urdf(plain_dishwasher(), tmp_path / "v1.2.urdf")
    assert [model.name for model in load_folder(tmp_path, DISHWASHER).models] == ["v1.2"]
    write_urdf(plain_dishwasher(), tmp_path / "v1.3.urdf")
    assert [model.name for model in load_folder(tmp_path, DISHWASHER).models] == ["v1.2", "v1.3"]
    write_urdf(plain_dishwasher(), tmp_path / "partnet" / "mobility.urdf")
    assert [model.name for model in load_folder(tmp_path / "partnet", DISHWASHER).models] == ["partnet"]
    assert [model.name for model in load_folder(tmp_path / "v1.3.urdf", DISHWASHER).models] == ["v1.3"]
    (tmp_path / "v1.3.urdf").rename(tmp_path / "V1.3.URDF")
    assert [model.name for model in load_folder(tmp_path, DISHWASHER).models] == ["V1.3", "partnet", "v1.2"]
    assert write_urdf(plain_dishwasher(), tmp_path / "folders" / "4" / "MODEL.URDF").name == "MODEL.URDF"
    assert [model.name for model in load_folder(tmp_path / "folders", DISHWASHER).models] == ["4"]


def test_folders_without_objects_are_refused(tmp_path):
    with pytest.raises(InputError, match="gone"):
        load_folder(tmp_path / "gone", DISHWASHER)
    with pytest.raises(InputError, match=r"\.urdf"):
        load_folder(tmp_path, DISHWASHER)


def test_a_lid_inside_its_jar_rests_where_its_file_says_whichever_way_its_thread_runs():
    jar, lid = box((-1, -1, -1), (1, 1, 1)), box((-0.5, -0.2, -0.5), (0.5, 0.2, 0.5))
    for slide in (0.01, -0.01):
        placed = np.array([0.0, 1.0, 0.0]), np.zeros(3), np.array([-2.0, 5.0])
        assert rest_state(Motion(1.0, slide), "closed", jar, lid, *placed) == 0


def test_every_rest_rule_has_its_geometry():
    assert {rule for _, rule in RULES} == set(get_args(RestRule))


def test_an_extra_joint_that_may_not_stand_at_zero_takes_the_joints_that_it_carries_with_it(tmp_path):
    """A door on a swivel that is turned by a tenth at least: its hinge turns with it, as its panel does."""
    plain = plain_dishwasher()

    def change(root) -> None:
        box_link(root, "swivel", (-0.1, 0.0, -0.2), (0.1, 0.05, 0.1))
        extra_joint(root, "sway", "body", "swivel", "revolute", lower="0.1", upper="0.2")
        root.find("joint/parent").set("link", "swivel")

    [found] = next(label_parts(read_articulation(edited(write_urdf(plain, tmp_path), change)), DISHWASHER))
    turn, [hinge] = Rotation.from_rotvec([0, 0, 0.1]), found.joints
    np.testing.assert_allclose(hinge.axis, turn.apply(plain.axes[0]), atol=1e-9)
    np.testing.assert_allclose(hinge.pivot, turn.apply(plain.pivots[0]), atol=1e-9)
    expected = turn.apply(plain.parts[1].vertices)
    gap = np.linalg.norm(found.links[1].mesh.vertices[:, None] - expected, axis=2).min(1)
    assert gap.max() < 1e-9
