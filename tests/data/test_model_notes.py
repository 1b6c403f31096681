"""Of models that do not fit, and of those that were understood otherwise than meant, it is said what may help."""

import numpy as np
import pytest

from helpers.own_models import box
from omad.common.errors import InputError
from omad.data.urdf_import.folder import import_model, load_folder
from omad.objects.category import Category, JointSpec, PartSpec
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf

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


def test_limits_the_wrong_way_round_are_exchanged_and_noted(tmp_path):
    file = write_urdf(cupboard(), tmp_path / "made")
    written = file.read_text()
    file.write_text(written.replace('lower="0.0" upper="0.3"', 'lower="0.3" upper="0.0"'))
    assert file.read_text() != written
    found = load_folder(tmp_path, CUPBOARD)
    assert [note.reason for note in found.notes] == ["slide has its lower limit above the upper: taken as exchanged"]
    assert np.allclose(found.models[0].limits[0], [0, 0.3])
