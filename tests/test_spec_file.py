"""Spec files: what people write means what they think, and every slip is named in one line with its cure."""

import json
import math
from dataclasses import asdict

import pytest

import omad
from omad.categories import CATEGORIES, JointSpec, PartSpec, ViewRange
from omad.checkpoint import category_from_dict
from omad.errors import InputError
from omad.rest_states import REST_RULES
from omad.spec_file import read_spec

SMALL = """
name = "microwave"
metres_per_unit = 0.3

[[parts]]
name = "body"

[[parts]]
name = "door"
[parts.joint]
type = "revolute"
axis = "-y"
limits = [0, 90]
"""
FULL = """
name = "desk"
metres_per_unit = 0.5
source_names = ["Table"]
basis_size = 6

[[parts]]
name = "top"
keypoints = 16
mirror = "self"
sides = [[0.5, 1], [0, 0.3], [0.1, 1]]
aliases = ["Board", "table_top"]

[[parts]]
name = "tray"
keypoints = 4
mirror = "other tray"
joint = { name = "rail", type = "prismatic", axis = [0, 0, 2], limits = [-0.1, 0.4], side = "+z+x" , rest = "zero" }

[[parts]]
name = "other tray"
keypoints = 4
mirror = "tray"
joint = { type = "prismatic", axis = "z", limits = [0, 0.4] }

[[parts]]
name = "flap"
joint = { type = "revolute", parent = "tray", axis = "+x", limits = [-45, 90], reach = "-z", rest = "perpendicular" }

[views]
azimuth = 180
elevation = [-10, 80]
roll = 0
"""


@pytest.fixture
def written(tmp_path):
    def write(text: str, name: str = "mine.toml"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def test_the_shortest_file_gives_sensible_defaults(written):
    found = omad.get_category(str(written(SMALL)))
    assert found.parts == (PartSpec("body", 12, None, ("body",)), PartSpec("door", 12, None, ("door",)))
    assert found.joints == (JointSpec("door_joint", "revolute", 0, (0.0, -1.0, 0.0), (0.0, math.pi / 2)),)
    assert found.rest == ("closed",)
    assert (found.views, found.basis_size, found.swap_symmetry) == (ViewRange(), 10, False)
    assert found.source_names == ()


def test_every_field_is_read_and_angles_are_degrees_and_lengths_metres(written):
    found = read_spec(written(FULL.replace("other tray", "other-tray")))
    assert [part.keypoints for part in found.parts] == [16, 4, 4, 12]
    assert [part.mirror for part in found.parts] == [0, 2, 1, None]
    assert found.parts[0].aliases == ("board", "table_top")
    assert found.parts[0].sides == ((0.5, 1.0), (0.0, 0.3), (0.1, 1.0))
    rail, _, flap = found.joints
    assert rail.name == "rail"
    assert rail.axis == (0.0, 0.0, 1.0)
    assert rail.limits == pytest.approx((-0.2, 0.8))  # category units
    assert rail.side == pytest.approx((math.sqrt(0.5), 0.0, math.sqrt(0.5)))
    assert flap.parent == 1
    assert flap.limits == pytest.approx((-math.pi / 4, math.pi / 2))
    assert flap.reach == (0.0, 0.0, -1.0)
    assert found.rest == ("zero", "closed", "perpendicular")
    assert found.views == ViewRange(math.pi, (math.radians(-10), math.radians(80)), 0.0)
    assert (found.basis_size, found.swap_symmetry, found.source_names) == (6, False, ("Table",))


def test_a_category_survives_its_checkpoint_exactly(written):
    found = read_spec(written(FULL.replace("other tray", "other-tray")))
    assert category_from_dict(json.loads(json.dumps(asdict(found)))) == found


def test_json_is_the_same_file(written):
    import tomllib

    text = FULL.replace("other tray", "other-tray")
    assert read_spec(written(json.dumps(tomllib.loads(text)), "mine.json")) == read_spec(written(text))


def test_built_in_categories_are_still_called_by_name():
    for name, category in CATEGORIES.items():
        assert omad.get_category(name) is category
    with pytest.raises(InputError, match=r"unknown category 'toaster'.*spec file"):
        omad.get_category("toaster")


def test_every_rest_rule_can_be_chosen(written):
    for kind, rule in REST_RULES:
        limits = f'limits = [0, 90]\nrest = "{rule}"'
        text = SMALL.replace('"revolute"', f'"{kind}"').replace("limits = [0, 90]", limits)
        assert read_spec(written(text)).rest == (rule,)


SLIPS = {
    "no name": ('name = "microwave"\n', "", "name: is missing"),
    "empty name": ('"microwave"', '""', "name: is ''; use letters"),
    "name of a number": ('"microwave"', "3", "name: is 3; give a name"),
    "built-in name": ('"microwave"', '"laptop"', "is a built-in category; choose another name"),
    "no unit": ("metres_per_unit = 0.3\n", "", "metres_per_unit: is missing; give a number above 0"),
    "unit zero": ("= 0.3", "= 0", "metres_per_unit: is 0; give a number above 0"),
    "unit not finite": ("= 0.3", "= nan", "metres_per_unit: is nan"),
    "unit true": ("= 0.3", "= true", "metres_per_unit: is True"),
    "unit a word": ("= 0.3", '= "0.3"', "metres_per_unit: is '0.3'"),
    "misspelt": ("metres_per_unit", "meters_per_unit", "meters_per_unit: is unknown; use metres_per_unit"),
    "misspelt below": ("axis =", "axes =", r"parts[1].joint.axes: is unknown; use axis"),
    "two of a name": ('name = "door"', 'name = "body"', "parts[0].name: two parts are called 'body'"),
    "no joint": ("[parts.joint]\n", "[parts.join]\n", "parts[1].join: is unknown; use joint"),
    "no type": ('type = "revolute"\n', "", "parts[1].joint.type: is missing; give revolute or prismatic"),
    "another type": ('"revolute"', '"hinge"', "parts[1].joint.type: is 'hinge'; give revolute or prismatic"),
    "no axis": ('axis = "-y"\n', "", "parts[1].joint.axis: is missing; give a direction"),
    "axis a word": ('"-y"', '"up"', "parts[1].joint.axis: is 'up'; give a direction"),
    "axis of nothing": ('"-y"', "[0, 0, 0]", "which has no direction"),
    "axis of nothing by letters": ('"-y"', '"+y-y"', "which has no direction"),
    "axis too short": ('"-y"', "[0, 1]", "parts[1].joint.axis: is [0, 1]; give a direction"),
    "no limits": ("limits = [0, 90]\n", "", "parts[1].joint.limits: is missing; give two numbers"),
    "limits turned": ("[0, 90]", "[90, 0]", "give the low end first"),
    "limits alone": ("[0, 90]", "[90]", "give two numbers"),
    "limits not finite": ("[0, 90]", "[0, inf]", "give two numbers"),
    "a rest of its own": ("limits", 'rest = "ajar"\nlimits', "parts[1].joint.rest: is 'ajar'; give closed or"),
    "a rest of another type": (
        'type = "revolute"', 'type = "prismatic"\nrest = "perpendicular"', "is 'perpendicular'; give closed or zero",
    ),
    "a parent that is not there": ("limits", 'parent = "lid"\nlimits', "parts[1].joint.parent: is 'lid'; give body"),
    "its own parent": ("limits", 'parent = "door"\nlimits', "parts[1].joint.parent: is 'door'; give body"),
    "the base on a joint": ('name = "body"\n', 'name = "body"\njoint = {}\n', "parts[0].joint: the first"),
    "half a keypoint": ('name = "body"\n', 'name = "body"\nkeypoints = 2.5\n', "parts[0].keypoints: is 2.5"),
    "odd mirror": (
        'name = "body"\n', 'name = "body"\nkeypoints = 7\nmirror = "self"\n', "parts[0].keypoints: are 7 on a part",
    ),
    "mirror unknown": ('name = "body"\n', 'name = "body"\nmirror = "left"\n', "parts[0].mirror: is 'left'; use"),
    "mirror one way": ('name = "body"\n', 'name = "body"\nmirror = "door"\n', "parts[0].mirror: is 'door', whose own"),
    "aliases a word": ('name = "body"\n', 'name = "body"\naliases = "body"\n', "parts[0].aliases: is 'body'"),
    "aliases of numbers": ('name = "body"\n', 'name = "body"\naliases = [3]\n', "parts[0].aliases: must be a list"),
    "no base": ('[[parts]]\nname = "body"\n', "", "parts[0].joint: the first part is the base"),
    "sides alone": ('name = "body"\n', 'name = "body"\nsides = [0.2, 0.5]\n', "parts[0].sides: is [0.2, 0.5]"),
    "sides turned": ('name = "body"\n', 'name = "body"\nsides = [[0, 1], [0, 1], [1, 0]]\n', "parts[0].sides"),
    "elevation": ("[0, 90]\n", "[0, 90]\n[views]\nelevation = [10, 100]\n", "views.elevation: is 10 to 100"),
    "azimuth": ("limits = [0, 90]\n", "limits = [0, 90]\n[views]\nazimuth = 270\n", "views.azimuth: is 270"),
    "swap": ("metres", 'swap_symmetry = "no"\nmetres', "swap_symmetry: is 'no'; give true or false"),
    "basis": ("metres", "basis_size = 0\nmetres", "basis_size: is 0; give a whole number from 1"),
    "broken TOML": ("[parts.joint]", "[parts.joint", "cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("slip", SLIPS)
def test_slips_are_named_with_file_field_and_cure(slip, written):
    old, new, message = SLIPS[slip]
    assert old in SMALL
    path = written(SMALL.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_spec(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_only_two_parts_can_be_swapped(written):
    assert read_spec(written(SMALL.replace("metres", "swap_symmetry = true\nmetres", 1))).swap_symmetry
    with pytest.raises(InputError, match="swap_symmetry: is for two parts, not 4"):
        read_spec(written(FULL.replace("other tray", "other-tray").replace("basis", "swap_symmetry = true\nbasis", 1)))


@pytest.mark.parametrize("text", ["[]", "3", '{"parts": 3}', '{"name": "a", "parts": ["body"]}', "{", '"a"'])
def test_json_of_another_shape_is_refused(text, written):
    with pytest.raises(InputError, match=r"mine\.json: ") as caught:
        read_spec(written(text, "mine.json"))
    assert "\n" not in str(caught.value)


def test_files_that_are_not_there_or_not_text_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        omad.get_category(tmp_path / "gone.toml")
    (tmp_path / "image.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read"):
        omad.get_category(tmp_path / "image.toml")
