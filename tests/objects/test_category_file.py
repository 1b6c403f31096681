"""Spec files: what people write means what they think, and every slip is named in one line with its cure."""

import json
import math
import re
import subprocess
import sys
from dataclasses import asdict
from typing import get_args

import pytest

import omad
from omad.common.errors import InputError
from omad.model.checkpoint import WEIGHTS, category_from_dict, shipped_categories
from omad.objects.builtin import builtin_names
from omad.objects.category import SLIDING_REST_RULES, JointSpec, PartSpec, RestRule, ViewRange
from omad.objects.category_file import read_spec

SMALL = """
name = "my_microwave"
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
    assert rail.side == (1.0, 0.0, 1.0)
    assert flap.parent == 1
    assert flap.limits == pytest.approx((-math.pi / 4, math.pi / 2))
    assert flap.reach == (0.0, 0.0, -1.0)
    assert [joint.rest for joint in found.joints] == ["zero", "closed", "perpendicular"]
    assert found.views == ViewRange(math.pi, (math.radians(-10), math.radians(80)), 0.0)
    assert (found.basis_size, found.swap_symmetry, found.source_names) == (6, False, ("Table",))


def test_a_category_survives_its_checkpoint_exactly(written):
    found = read_spec(written(FULL.replace("other tray", "other-tray")))
    assert category_from_dict(json.loads(json.dumps(asdict(found)))) == found


def test_json_is_the_same_file(written):
    import tomllib

    text = FULL.replace("other tray", "other-tray")
    assert read_spec(written(json.dumps(tomllib.loads(text)), "mine.json")) == read_spec(written(text))


def test_files_of_windows_are_read(written):
    path = written(SMALL)
    path.write_bytes(b"\xef\xbb\xbf" + SMALL.replace("\n", "\r\n").encode())  # a byte order mark
    assert read_spec(path) == read_spec(written(SMALL, "other.toml"))


def test_shipped_categories_are_called_by_name():
    assert {"dishwasher", "drawer", "eyeglasses", "laptop", "scissors"} < {*builtin_names()}
    for name in builtin_names():
        assert omad.get_category(name).name == name
        assert omad.get_category(name) is omad.get_category(name)
    with pytest.raises(InputError, match="toaster"):
        omad.get_category("toaster")


def test_names_of_shipped_categories_need_no_network_library():
    code = "import sys; from omad.objects.builtin import builtin_names; builtin_names(); print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_shipped_specs_are_those_that_the_weights_were_trained_with():
    configs = list(WEIGHTS.rglob("config.json"))
    assert len(configs) >= len(shipped_categories())
    for config in configs:
        category = category_from_dict(json.loads(config.read_text())["category"])
        assert category == omad.get_category(category.name)


def test_checkpoints_from_before_joints_had_rest_rules_are_read(written):
    found = read_spec(written(FULL.replace("other tray", "other-tray")))
    old = json.loads(json.dumps(asdict(found)))
    old["rest"] = [joint.pop("rest") for joint in old["joints"]]
    assert category_from_dict(old) == found


DAMAGE = {
    "metres_per_unit": lambda c: c.update(metres_per_unit=0),
    "basis_size": lambda c: c.update(basis_size=True),
    "parts[0].keypoints": lambda c: c["parts"][0].pop("keypoints"),
    "parts[1].mirror": lambda c: c["parts"][1].update(mirror=7),
    "joints[0].axis": lambda c: c["joints"][0].update(axis=[0, 1]),
    "joints[0].axis[2]": lambda c: c["joints"][0].update(axis=[0, 1, math.nan]),
    "joints[2].rest": lambda c: c["joints"][2].update(rest="ajar"),
    "joints[0].colour": lambda c: c["joints"][0].update(colour="red"),
    "parts[1].joint.parent": lambda c: c["joints"][0].update(parent=1),
    "parts[2].joint.at_most": lambda c: c["joints"][1].update(at_most=1),
    "parts[3].joint.at_most": lambda c: c["joints"][2].update(at_most=0),
    "parts": lambda c: c.update(parts=3),
    "views.roll": lambda c: c["views"].update(roll=-1),
}


@pytest.mark.parametrize("field", DAMAGE)
def test_a_checkpoints_category_is_checked_as_a_spec_file_is(field, written):
    values = json.loads(json.dumps(asdict(read_spec(written(FULL.replace("other tray", "other-tray"))))))
    DAMAGE[field](values)
    with pytest.raises(ValueError, match=f"^{re.escape(field)}: "):
        category_from_dict(values)


def test_a_screw_turns_and_advances(written):
    (screw,) = read_spec(written(SMALL.replace('"revolute"', '"screw"\npitch = -0.01'))).joints
    assert screw.pitch == -0.01
    assert screw.limits == pytest.approx((0.0, math.pi / 2))


def test_every_rest_rule_can_be_chosen(written):
    for kind, high, rules in (("revolute", 90, get_args(RestRule)), ("prismatic", 0.3, SLIDING_REST_RULES)):
        for rule in rules:
            limits = f'limits = [0, {high}]\nreach = "+x"\nrest = "{rule}"'
            text = SMALL.replace('"revolute"', f'"{kind}"').replace("limits = [0, 90]", limits)
            assert read_spec(written(text)).joints[0].rest == rule


SLIPS = {
    "no name": ('name = "my_microwave"\n', "", "name"),
    "empty name": ('"my_microwave"', '""', "name"),
    "name of a number": ('"my_microwave"', "3", "name"),
    "the name of any": ('"my_microwave"', '"auto"', "name"),
    "sides in per cent": (
        'name = "door"', 'name = "door"\nsides = [[30, 100], [0, 1], [0, 1]]', "parts[1].sides",
    ),
    "built-in name": ('"my_microwave"', '"laptop"', "name"),
    "no unit": ("metres_per_unit = 0.3\n", "", "metres_per_unit"),
    "unit zero": ("= 0.3", "= 0", "metres_per_unit"),
    "unit not finite": ("= 0.3", "= nan", "metres_per_unit"),
    "unit in millimetres": ("= 0.3", "= 300", "metres_per_unit: is 300; give metres, from 0.001 to 10"),
    "unit too small": ("= 0.3", "= 0.0003", "metres_per_unit"),
    "unit true": ("= 0.3", "= true", "metres_per_unit"),
    "unit a word": ("= 0.3", '= "0.3"', "metres_per_unit"),
    "misspelt": ("metres_per_unit", "meters_per_unit", "meters_per_unit"),
    "misspelt below": ("axis =", "axes =", "parts[1].joint.axes"),
    "two of a name": ('name = "door"', 'name = "body"', "parts[0].name"),
    "a part called as a frame": ('name = "door"', 'name = "world"', "parts[1].name"),
    "no joint": ("[parts.joint]\n", "[parts.join]\n", "parts[1].join"),
    "no type": ('type = "revolute"\n', "", "parts[1].joint.type"),
    "another type": ('"revolute"', '"hinge"', "parts[1].joint.type"),
    "no axis": ('axis = "-y"\n', "", "parts[1].joint.axis"),
    "axis a word": ('"-y"', '"up"', "parts[1].joint.axis"),
    "axis of nothing": ('"-y"', "[0, 0, 0]", "parts[1].joint.axis"),
    "axis of nothing by letters": ('"-y"', '"+y-y"', "parts[1].joint.axis"),
    "axis too short": ('"-y"', "[0, 1]", "parts[1].joint.axis"),
    "reach along the axis": ("limits", 'reach = "+y"\nlimits', "parts[1].joint.reach"),
    "no limits": ("limits = [0, 90]\n", "", "parts[1].joint.limits"),
    "limits turned": ("[0, 90]", "[90, 0]", "parts[1].joint.limits"),
    "limits alone": ("[0, 90]", "[90]", "parts[1].joint.limits"),
    "limits not finite": ("[0, 90]", "[0, inf]", "parts[1].joint.limits"),
    "limits in radians": ("[0, 90]", "[0, 1.57]", "parts[1].joint.limits"),
    "limits in millimetres": (
        'type = "revolute"\naxis = "-y"\nlimits = [0, 90]', 'type = "prismatic"\naxis = "+z"\nlimits = [0, 300]',
        "parts[1].joint.limits",
    ),
    "a rest of its own": ("limits", 'rest = "ajar"\nlimits', "parts[1].joint.rest"),
    "a rest of another type": (
        'type = "revolute"', 'type = "prismatic"\nrest = "perpendicular"', "parts[1].joint.rest",
    ),
    "a pitch where none can be": ("limits", "pitch = 0.1\nlimits", "parts[1].joint.pitch"),
    "a screw without a pitch": ('"revolute"', '"screw"', "parts[1].joint.pitch"),
    "a parent that is not there": ("limits", 'parent = "lid"\nlimits', "parts[1].joint.parent"),
    "its own parent": ("limits", 'parent = "door"\nlimits', "parts[1].joint.parent"),
    "at most a joint that is not there": ("limits", 'at_most = "lid"\nlimits', "parts[1].joint.at_most"),
    "the base on a joint": (
        'name = "body"\n',
        'name = "body"\njoint = { type = "revolute", axis = "x", limits = [0, 9] }\n',
        "parts[0].joint",
    ),
    "half a keypoint": ('name = "body"\n', 'name = "body"\nkeypoints = 2.5\n', "parts[0].keypoints"),
    "odd mirror": (
        'name = "body"\n', 'name = "body"\nkeypoints = 7\nmirror = "self"\n', "parts[0].keypoints",
    ),
    "mirror unknown": ('name = "body"\n', 'name = "body"\nmirror = "left"\n', "parts[0].mirror"),
    "mirror one way": ('name = "body"\n', 'name = "body"\nmirror = "door"\n', "parts[0].mirror"),
    "aliases a word": ('name = "body"\n', 'name = "body"\naliases = "body"\n', "parts[0].aliases"),
    "aliases of numbers": ('name = "body"\n', 'name = "body"\naliases = [3]\n', "parts[0].aliases[0]"),
    "no base": ('[[parts]]\nname = "body"\n', "", "parts[0].joint"),
    "sides alone": ('name = "body"\n', 'name = "body"\nsides = [0.2, 0.5]\n', "parts[0].sides"),
    "sides turned": ('name = "body"\n', 'name = "body"\nsides = [[0, 1], [0, 1], [1, 0]]\n', "parts[0].sides"),
    "elevation": ("[0, 90]\n", "[0, 90]\n[views]\nelevation = [10, 100]\n", "views.elevation"),
    "elevation in radians": ("[0, 90]\n", "[0, 90]\n[views]\nelevation = [0.1, 1.2]\n", "views.elevation"),
    "azimuth in radians": ("[0, 90]\n", "[0, 90]\n[views]\nazimuth = 3.14\n", "views.azimuth"),
    "azimuth": ("limits = [0, 90]\n", "limits = [0, 90]\n[views]\nazimuth = 270\n", "views.azimuth"),
    "swap": ("metres", 'swap_symmetry = "no"\nmetres', "swap_symmetry"),
    "basis": ("metres", "basis_size = 0\nmetres", "basis_size"),
    "broken TOML": ("[parts.joint]", "[parts.joint", ""),
}  # fmt: skip


@pytest.mark.parametrize("slip", SLIPS)
def test_slips_are_named_with_file_field_and_cure(slip, written):
    old, new, field = SLIPS[slip]
    assert old in SMALL
    path = written(SMALL.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_spec(path)
    assert str(caught.value).startswith(f"{path}: {field}: " if field else f"{path}: ")
    assert "\n" not in str(caught.value)


def test_only_two_parts_can_be_swapped(written):
    assert read_spec(written(SMALL.replace("metres", "swap_symmetry = true\nmetres", 1))).swap_symmetry
    with pytest.raises(InputError, match="swap_symmetry: "):
        read_spec(written(FULL.replace("other tray", "other-tray").replace("basis", "swap_symmetry = true\nbasis", 1)))


@pytest.mark.parametrize("text", ["[]", "3", '{"parts": 3}', '{"name": "a", "parts": ["body"]}', "{", '"a"'])
def test_json_of_another_shape_is_refused(text, written):
    with pytest.raises(InputError, match=r"mine\.json: ") as caught:
        read_spec(written(text, "mine.json"))
    assert "\n" not in str(caught.value)


def test_files_that_are_not_there_or_not_text_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"gone\.toml"):
        omad.get_category(tmp_path / "gone.toml")
    (tmp_path / "image.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"image\.toml"):
        omad.get_category(tmp_path / "image.toml")
