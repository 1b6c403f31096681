"""Of models that do not fit, and of those that were understood otherwise than meant, it is said what may help."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import omad
from helpers.own_models import SPECS, Z_UP, box, microwave, seen_from_elsewhere, write_microwaves
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.urdf_import.folder import import_model, load_folder
from omad.data.urdf_import.importing import import_folder
from omad.objects.category import Category, JointSpec, PartSpec
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf

MICROWAVE = omad.get_category(SPECS / "microwave.toml")
CUPBOARD = Category(
    name="cupboard",
    metres_per_unit=0.5,
    parts=(PartSpec("body", 2), PartSpec("drawer", 2), PartSpec("door", 2, aliases=("door",))),
    joints=(
        JointSpec("slide", "prismatic", 0, (0, 0, 1), (0, 0.6), side=(0, 1, 0)),
        JointSpec("hinge", "revolute", 0, (0, -1, 0), (0, 1.7), reach=(1, 0, 0), side=(0, -1, 1)),
    ),
)


def cupboard(limits=((0, 0.3), (0, 1.6))) -> ObjectModel:
    body, drawer = box((-0.3, 0, -0.25), (0.3, 0.8, 0.2)), box((-0.29, 0.55, -0.2), (0.29, 0.79, 0.22))
    parts = body, drawer, box((-0.29, 0.01, 0.2), (0.29, 0.54, 0.22))
    pivots, axes = np.array([[0, 0, 0], [-0.29, 0, 0.2]]), np.array([joint.axis for joint in CUPBOARD.joints])
    return ObjectModel.of(CUPBOARD, "made", parts, axes, pivots, np.array(limits)).centred()


def test_of_a_model_that_does_not_fit_what_may_help_is_said(tmp_path):
    file = write_urdf(cupboard().mirrored(), tmp_path / "mirrored")
    with pytest.raises(InputError, match=r"says, mostly.*; its mirror image fits: .*\(either_hand\)$"):
        import_model(file, CUPBOARD)  # and no shipped category of fewer parts, which would fit, too
    file = write_urdf(cupboard(limits=((0, 0.3), (-1.6, 0))), tmp_path / "inward")
    file.write_text(file.read_text().replace('"hinge"', '"j 2"'))
    with pytest.raises(InputError, match=r"'j 2' moves -92° to 0° .* a cupboard 0° to 97°: turn its axis round"):
        import_model(file, CUPBOARD)
    file = write_urdf(cupboard(), tmp_path / "points")
    next(file.parent.glob("meshes/*door.obj")).write_text("v 0 0 0\n")
    with pytest.raises(InputError, match=r"; no triangles in meshes/model-2-door\.obj"):
        import_model(file, CUPBOARD)


def test_a_joint_that_follows_another_and_metres_called_as_those_of_partnet_are_noted(tmp_path):
    file = write_urdf(cupboard(), tmp_path / "made" / "mobility.urdf")
    file.write_text(file.read_text()[: -len("</joint>\n</robot>\n")] + '<mimic joint="slide"/></joint></robot>')
    follows, metres = (note.reason for note in load_folder(tmp_path, CUPBOARD).notes)
    assert follows.startswith("hinge moves by itself")
    assert "scaled by 0.5" in metres
    assert "give --scale 1" in metres
    assert len(load_folder(tmp_path, CUPBOARD, scale=1.0).notes) == 1


def test_a_part_without_one_of_its_meshes_is_noted(tmp_path):
    file = write_urdf(cupboard(), tmp_path / "made")
    shape = '<visual><geometry><mesh filename="meshes/knob.obj"/></geometry></visual>'
    file.write_text(file.read_text().replace("</link>", f"{shape}</link>", 1))
    (file.parent / "meshes" / "knob.obj").write_text("")
    [note] = load_folder(tmp_path, CUPBOARD).notes
    assert note.reason == "no triangles in meshes/knob.obj: taken without; export again what should have some"


def test_limits_the_wrong_way_round_are_exchanged_and_noted(tmp_path):
    file = write_urdf(cupboard(), tmp_path / "made")
    written = file.read_text()
    file.write_text(written.replace('lower="0.0" upper="0.3"', 'lower="0.3" upper="0.0"'))
    assert file.read_text() != written
    found = load_folder(tmp_path, CUPBOARD)
    assert [note.reason for note in found.notes] == ["slide has its lower limit above the upper: taken as exchanged"]
    assert np.allclose(found.models[0].limits[0], [0, 0.3])


@pytest.mark.parametrize("end", ["inf", "1e300", "3.4e38"])
def test_limits_that_mean_none_are_as_if_left_out(end, tmp_path):
    file = write_urdf(cupboard(), tmp_path / "made")
    written, given = file.read_text(), 'lower="0.0" upper="0.3"'
    assert given in written
    file.write_text(written.replace(given, ""))
    expected = import_model(file, CUPBOARD).limits
    for none in (f'lower="-{end}" upper="{end}"', f'lower="0.0" upper="{end}"'):
        file.write_text(written.replace(given, none))
        assert np.array_equal(import_model(file, CUPBOARD).limits, expected)
    file.write_text(written.replace(given, 'lower="0.0" upper="nan"'))
    with pytest.raises(InputError, match="limits of joint 'slide' are no numbers; leave them out"):
        import_model(file, CUPBOARD)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def drop_down(R_file_upright: np.ndarray) -> ObjectModel:
    """A microwave that stands upright hinged at the bottom, which is laid on its side to hinge on the left."""
    lying = microwave("drop-down")
    R = R_file_upright @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    parts = tuple(part.warped(lambda vertices: vertices @ R.T) for part in lying.parts)
    return replace(lying, parts=parts, axes=lying.axes @ R.T, pivots=lying.pivots @ R.T)


@pytest.mark.usefixtures("elsewhere")
def test_a_model_that_lies_among_upright_ones_is_named():
    write_microwaves(Path("models"), 3)
    write_urdf(drop_down(Z_UP), Path("models/drop-down/drop-down.urdf"))
    for _ in range(2):  # and again where all is there already
        summary = import_folder(Path("models"), MICROWAVE, Path("ours"))
        assert len(summary.used) == 4
        assert [note.name for note in summary.notes] == ["drop-down"]
        assert "with +z" in summary.notes[0].reason


@pytest.mark.usefixtures("elsewhere")
def test_a_model_that_lies_alone_is_named():
    write_urdf(drop_down(np.eye(3)), Path("lone"))
    [note] = import_folder(Path("lone"), MICROWAVE, Path("ours")).notes
    assert "x up, most files have z or y up" in note.reason
    assert load_folder("lone", MICROWAVE).notes == [note]  # whichever command reads the folder


@pytest.mark.usefixtures("elsewhere")
def test_models_that_all_lie_are_named():
    for name in ("one", "two", "three"):
        write_urdf(drop_down(np.eye(3)), Path("all") / name / f"{name}.urdf")
    notes = load_folder("all", MICROWAVE).notes
    assert {note.name for note in notes} == {"one", "two", "three"}
    assert all("x up, most files have z or y up" in note.reason for note in notes)


@pytest.mark.usefixtures("elsewhere")
@pytest.mark.parametrize(
    ("file", "turn", "said"),
    [
        ("made/made.urdf", np.diag([1.0, -1.0, -1.0]), "-y up, most files have z or y up"),
        ("made/mobility.urdf", np.diag([-1.0, 1.0, -1.0]), "+y up, PartNet-Mobility's files have z up"),
        ("made/made.urdf", np.diag([-1.0, 1.0, -1.0]), None),
        ("made/mobility.urdf", Z_UP, None),
    ],
    ids=["on its head", "on its side in PartNet-Mobility", "y up", "z up in PartNet-Mobility"],
)
def test_what_a_lone_file_has_up_is_doubted_where_such_files_never_have_it(file, turn, said):
    category = omad.get_category("dishwasher")
    made = generate(category, 0)
    parts = tuple(part.warped(lambda vertices: vertices @ turn.T) for part in made.parts)
    write_urdf(replace(made, parts=parts, axes=made.axes @ turn.T, pivots=made.pivots @ turn.T), Path(file))
    for notes in (
        load_folder("made", category, 1.0).notes,
        import_folder(Path("made"), category, Path("ours"), 1.0).notes,
    ):
        assert [note.reason.split(": ")[0] for note in notes] == ([f"stands with its file's {said}"] if said else [])


@pytest.mark.usefixtures("elsewhere")
def test_of_a_mirror_image_the_field_that_takes_it_is_named():
    write_microwaves(Path("ovens"), 3)
    write_urdf(seen_from_elsewhere(microwave("odd").mirrored(), np.zeros(1)), Path("ovens/odd/odd.urdf"))
    [note] = import_folder(Path("ovens"), MICROWAVE, Path("out")).notes
    assert note.name == "odd"
    assert "either_hand = true" in note.reason
    [note] = import_folder(Path("ovens"), replace(MICROWAVE, either_hand=True), Path("both")).notes
    assert "mirror image" in note.reason
    assert "either_hand" not in note.reason
