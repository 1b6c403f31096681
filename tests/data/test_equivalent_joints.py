"""Files that say the same with other joints import as the spec has it."""

import os
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.own_models import JAR, JAR_PITCH, jar, seen_from_elsewhere, stapler
from omad import get_category
from omad.common.errors import InputError
from omad.data.urdf_import.articulation import read_articulation
from omad.data.urdf_import.folder import import_model, load_folder
from omad.geometry.kinematics import KinematicTree
from omad.objects.urdf import write_urdf

DOCS = Path(__file__).parents[2] / "docs"
MODELS = Path(os.environ.get("OMAD_MODELS", "nowhere"))


def jar_of_two_joints(folder: Path) -> tuple[Path, object]:
    """A lid that turns without limits and slides between some, neither told by the other."""
    made = jar()
    file = folder / "jar.urdf"
    write_urdf(made, file)
    tree = ElementTree.parse(file)
    for joint in tree.getroot().findall("joint"):
        if (mimic := joint.find("mimic")) is not None:
            joint.remove(mimic)
            joint.find("limit").attrib |= {"lower": "0", "upper": str(1.5 * JAR_PITCH)}
        else:
            joint.set("type", "continuous")
            joint.remove(joint.find("limit"))
    tree.write(file)
    return file, made


@pytest.mark.parametrize("rest", ["zero", "closed"])
def test_a_turn_and_a_slide_about_one_axis_are_a_screw(rest, tmp_path):
    spec = tmp_path / "jar.toml"
    bottle = JAR.replace("my_jar", "bottle").replace('"jar"', '"bottle"')
    spec.write_text(bottle.replace('rest = "zero"', f'rest = "{rest}"'))
    file, made = jar_of_two_joints(tmp_path)
    found = import_model(file, get_category(spec))
    assert found.tree == made.tree
    np.testing.assert_allclose(found.limits, [[0, 3 * np.pi]], atol=1e-9)
    np.testing.assert_allclose(found.axes, made.axes, atol=1e-9)
    high = np.array([2 * np.pi])
    rise = found.posed_vertices(high)[1] - found.parts[1].vertices
    np.testing.assert_allclose(rise, np.broadcast_to([0, JAR_PITCH, 0], rise.shape), atol=1e-9)


def test_a_slide_that_follows_a_turn_begins_at_its_offset(tmp_path):
    file = tmp_path / "jar.urdf"
    write_urdf(jar(), file)
    before = read_articulation(file).links[1].mesh.vertices
    file.write_text(file.read_text().replace('offset="0"', 'offset="0.01"'))
    raised = read_articulation(file).links[1].mesh.vertices - before
    np.testing.assert_allclose(raised, np.broadcast_to([0, 0.01, 0], raised.shape), atol=1e-9)


@pytest.mark.parametrize("slide_first", [True, False])
@pytest.mark.parametrize("turn_follows", [True, False])
def test_a_slide_and_a_turn_are_a_screw_whichever_is_first_and_whichever_follows(slide_first, turn_follows, tmp_path):
    file, made = jar_of_two_joints(tmp_path)
    tree = ElementTree.parse(file)
    turn, slide = tree.getroot().findall("joint")
    if slide_first:
        for tag in ("parent", "child"):
            (turn_end, slide_end) = (turn.find(tag), slide.find(tag))
            turn_end.attrib, slide_end.attrib = dict(slide_end.attrib), dict(turn_end.attrib)
    per_radian, start = 0.01, 0.002
    follower, leader, multiplier, offset = (
        (turn, slide, 1 / per_radian, -start / per_radian) if turn_follows else (slide, turn, per_radian, start)
    )
    said = {"joint": leader.get("name"), "multiplier": str(multiplier), "offset": str(offset)}
    ElementTree.SubElement(follower, "mimic", said)
    tree.write(file)
    found, plain = read_articulation(file), made.parts[1]
    [joint] = found.joints
    assert joint.follows is None
    np.testing.assert_allclose([joint.motion.turn, joint.motion.slide], [1, per_radian])
    np.testing.assert_allclose(found.links[1].mesh.vertices, plain.vertices + [0, start, 0], atol=1e-9)
    np.testing.assert_allclose(joint.limits, [(0 - start) / per_radian, (1.5 * JAR_PITCH - start) / per_radian])


def test_parts_on_one_hinge_may_hang_on_each_other_or_not(tmp_path):
    """A stapler whose magazine turns on the base, where the spec has it turn on the lid."""
    category, made = get_category(DOCS / "categories/stapler.toml"), stapler()
    other = replace(made, tree=KinematicTree((0, 0), made.tree.motions))
    write_urdf(seen_from_elsewhere(other, np.zeros(2)), tmp_path / "s.urdf")
    found = import_model(tmp_path / "s.urdf", category)
    assert found.tree == made.tree
    np.testing.assert_allclose(found.axes, made.axes, atol=1e-9)
    np.testing.assert_allclose(found.part_boxes(), made.part_boxes(), atol=1e-9)
    assert (found.limits[:, 1] > np.radians(95)).all()


def test_parts_on_hinges_apart_do_not(tmp_path):
    category, made = get_category(DOCS / "categories/stapler.toml"), stapler()
    pivots = made.pivots + np.array([[0, 0, 0], [0, 0, 0.08]])
    other = replace(made, tree=KinematicTree((0, 0), made.tree.motions), pivots=pivots)
    write_urdf(other, tmp_path / "s.urdf")
    with pytest.raises(InputError, match="do not form the tree of a my_stapler"):
        import_model(tmp_path / "s.urdf", category)


@pytest.mark.skipif(not MODELS.is_dir(), reason="OMAD_MODELS names no folder of real models")
def test_real_bottles_have_screws(tmp_path):
    spec = tmp_path / "bottle.toml"
    spec.write_text(
        JAR.replace("my_jar", "bottle").replace('"jar"', '"bottle"').replace('rest = "zero"', 'rest = "closed"')
    )
    found = load_folder(MODELS / "bottle", get_category(spec))
    assert not found.refused
    assert [model.name for model in found.models] == ["3596", "4084", "6263"]
    for model in found.models:
        bottle, lid = model.part_boxes()
        assert lid[1, 1] >= bottle[1, 1] - 1e-6
        assert model.limits[0, 0] == 0
        assert model.limits[0, 1] > 0.5
