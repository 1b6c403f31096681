"""omad import with a stranger's files: nothing of anybody else's goes, nothing outside is opened, one bad model is
left out."""

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.command_line import answer
from helpers.own_models import SPECS, microwave, write_microwaves
from omad import get_category
from omad.common.errors import InputError
from omad.data.urdf_import.articulation import read_articulation, read_urdf
from omad.data.urdf_import.importing import import_folder
from omad.objects.urdf import write_urdf

SPEC = SPECS / "microwave.toml"
MICROWAVE = get_category(SPEC)
BOX = '<visual><geometry><box size="1 1 1"/></geometry></visual>'


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")


@pytest.fixture
def imported() -> Path:
    write_microwaves(Path("models"), 2)
    import_folder(Path("models"), MICROWAVE, Path("ours"))
    return Path("ours/import.json")


def edit(record: Path, change) -> None:
    values = json.loads(record.read_text())
    change(values)
    record.write_text(json.dumps(values))


@pytest.mark.parametrize("absolute", [False, True])
@pytest.mark.parametrize("field", ["stamps", "written"])
def test_a_record_that_names_another_folder_deletes_nothing(imported, field, absolute):
    victim = Path("victim")
    victim.mkdir()
    (victim / "thesis.txt").write_text("years of work")
    name = str(victim.resolve()) if absolute else "../victim"
    edit(imported, lambda record: record[field].update({name: "0" if field == "stamps" else {"thesis.txt": "0"}}))
    with pytest.raises(InputError, match=r"import\.json: .*victim"):
        import_folder(Path("models"), MICROWAVE, Path("ours"))
    assert (victim / "thesis.txt").read_text() == "years of work"


@pytest.mark.parametrize("path", ["../../victim/thesis.txt", "/etc/hostname", "a/../../b", "", "a//b"])
def test_a_record_that_names_files_outside_is_refused(imported, path):
    edit(imported, lambda record: record["written"]["oven-0-0"].update({path: "0"}))
    with pytest.raises(InputError, match="oven-0-0"):
        import_folder(Path("models"), MICROWAVE, Path("ours"))


def test_what_was_made_with_a_spec_that_was_mended_is_made_anew(imported):
    file = Path("ours/oven-0-0/oven-0-0.urdf")
    mended = replace(MICROWAVE, joints=(replace(MICROWAVE.joints[0], limits=(0.0, 0.5)),))
    for spec, upper in ((mended, 0.5), (mended, 0.5), (MICROWAVE, np.pi / 2)):
        assert import_folder(Path("models"), spec, Path("ours")).used == ["oven-0-0", "oven-0-1"]
        assert read_urdf(file, spec).limits[0, 1] == pytest.approx(upper)
    with pytest.raises(InputError, match="another category"):
        import_folder(Path("models"), replace(MICROWAVE, name="other"), Path("ours"))


def test_a_folder_among_the_models_is_none_of_them(imported):
    for _ in range(2):
        assert not import_folder(Path("models"), MICROWAVE, Path("models/ours")).refused


def test_lone_files_beside_the_folder_they_are_imported_to_are_imported_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_urdf(microwave("one"), "lone/one.urdf")
    times = []
    for _ in range(3):
        assert import_folder(Path("lone"), MICROWAVE, Path("lone/ours")).used == ["one"]
        times.append(Path("lone/ours/one/one.urdf").stat().st_mtime_ns)
    assert len(set(times)) == 1


def test_what_another_put_into_the_folder_stays(imported):
    """Of a model that goes from the source, only the files go that the import wrote, as it wrote them."""
    Path("ours/oven-0-1/notes.txt").write_text("mine")
    Path("ours/mine").mkdir()
    Path("ours/mine/mine.urdf").write_text("<robot/>")
    edit(imported, lambda record: record["stamps"].update(mine="0"))
    changed = Path("ours/oven-0-1/oven-0-1.urdf")
    changed.write_text(changed.read_text() + "<!-- my own -->")
    for name in ("oven-0-0", "oven-0-1"):
        shutil.rmtree(Path("models") / name)
    write_urdf(microwave("third"), "models/third/third.urdf")
    import_folder(Path("models"), MICROWAVE, Path("ours"))
    assert not Path("ours/oven-0-0").exists()
    assert sorted(path.name for path in Path("ours/oven-0-1").rglob("*")) == ["notes.txt", "oven-0-1.urdf"]
    assert Path("ours/mine/mine.urdf").exists()


def test_nothing_is_written_or_deleted_through_a_link(imported, tmp_path):
    outside = tmp_path / "outside"
    shutil.move("ours/oven-0-0", outside)
    Path("ours/oven-0-0").symlink_to(outside)
    before = {path: path.read_bytes() for path in outside.rglob("*") if path.is_file()}
    write_urdf(microwave("oven-0-0", width=0.6), "models/oven-0-0/oven-0-0.urdf")
    found = import_folder(Path("models"), MICROWAVE, Path("ours"))
    assert [refusal.name for refusal in found.refused] == ["oven-0-0"]
    assert {path: path.read_bytes() for path in outside.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("stamps", None), ("stamps", []), ("stamps", {"oven-0-0": 1}), ("notes", {"oven-0-0": None}), ("notes", []),
        ("options", []), ("written", {"oven-0-0": []}), ("notes", {}),
    ],
)  # fmt: skip
def test_a_broken_record_is_named(imported, field, value):
    edit(imported, lambda record: record.update({field: value}))
    if value == {}:
        assert len(import_folder(Path("models"), MICROWAVE, Path("ours")).models) == 2
    else:
        with pytest.raises(InputError, match=r"import\.json: " + field):
            import_folder(Path("models"), MICROWAVE, Path("ours"))


def link(name: str, inside: str = BOX) -> str:
    return f'<link name="{name}">{inside}</link>'


def robot(*elements: str) -> str:
    return '<robot name="r">' + "".join(elements) + "</robot>"


def hinged(inside: str) -> str:
    hinge = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/>' + inside + "</joint>"
    return robot(link("a"), link("b"), hinge)


def shaped(shape: str) -> str:
    return robot(link("a", f"<visual><geometry>{shape}</geometry></visual>"))


BAD = {
    "encoding": '<?xml version="1.0" encoding="foo"?><robot name="r"/>',
    "wide encoding": '<?xml version="1.0" encoding="utf-32"?><robot name="r"/>',
    "punycode": '<?xml version="1.0" encoding="punycode"?><robot name="r">\x80</robot>',
    "axis": hinged('<axis xyz="1 0"/>'),
    "far": hinged('<origin xyz="1e300 0 0"/>'),
    "limit": hinged('<limit lower="0" upper="nan"/>'),
    "capsule": shaped('<capsule radius="1" length="2"/>'),
    "box": shaped('<box size="1 0"/>'),
    "no size": shaped('<box size="1 0 1"/>'),
    "scale": shaped('<mesh filename="a.obj" scale="1 0"/>'),
    "long mesh": shaped(f'<mesh filename="{"x" * 5000}"/>'),
    "entity": '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/hostname">]><robot name="&a;"/>',
    "deep": "<robot>" + "<a>" * 100000 + "</a>" * 100000 + "</robot>",
    "binary": "\0\1\2",
}


def test_a_xacro_file_is_named_as_one(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="a" value="1"/></robot>')
    with pytest.raises(InputError, match="run xacro on it"):
        read_articulation(file)


def test_what_no_one_looks_at_may_be_odd(tmp_path):
    """What xacro wrote still names it, robots have no name, and bodies for contacts are of more shapes."""
    file = tmp_path / "odd.urdf"
    shapes = "<visual>{}</visual><collision>{}</collision>".format(
        *(f"<geometry>{shape}</geometry>" for shape in ('<box size="1 1 1"/>', '<capsule radius="1" length="2"/>'))
    )
    file.write_text(f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="a">{shapes}</link></robot>')
    assert read_articulation(file).name == "odd"


@pytest.mark.parametrize("attribute", ['name="${name}"', 'filename="$(find oven)/a.obj"'])
def test_a_xacro_file_without_its_namespace_is_named_as_one(attribute, tmp_path):
    file = tmp_path / "odd.urdf"
    file.write_text(f"<robot><link {attribute}/></robot>")
    with pytest.raises(InputError, match="run xacro on it"):
        read_articulation(file)


def test_a_shape_that_no_urdf_has_is_named(tmp_path):
    file = tmp_path / "bad.urdf"
    file.write_text(BAD["capsule"])
    with pytest.raises(InputError, match=r"link 'a' has a geometry of no known shape, capsule; give a mesh, box"):
        read_articulation(file)


def test_limits_in_degrees_are_told_of():
    write_microwaves(Path("models"), 1)
    [file] = Path("models").rglob("*.urdf")
    text, said = re.sub(r'lower="[^"]*" upper="[^"]*"', 'lower="0" upper="90"', file.read_text()), []
    for limits in (text, text.replace('"90"', '"1.5"')):
        file.write_text(limits)
        said.append([note.reason for note in import_folder(Path("models"), MICROWAVE, Path("ours")).notes])
    assert said == [["limits of door_joint are radians in a URDF; of degrees so large, divide them by 57.3"], []]


@pytest.mark.parametrize("text", BAD.values(), ids=BAD.keys())
def test_a_bad_urdf_is_one_line(text, tmp_path):
    file = tmp_path / "bad.urdf"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"bad\.urdf: ") as caught:
        read_articulation(file)
    assert len(str(caught.value)) < 6000
    assert "\n" not in str(caught.value)


def test_one_bad_model_is_left_out_and_the_rest_imported(capsys):
    write_microwaves(Path("models"), 2)
    for name, text in BAD.items():
        Path("models", name).mkdir()
        Path("models", name, f"{name}.urdf").write_bytes(text.encode("latin-1"))
    found = answer(capsys, "import", "models", "--category", str(SPEC), "--output", "ours")
    assert found["used"] == ["oven-0-0", "oven-0-1"]
    assert sorted(refusal["name"] for refusal in found["refused"]) == sorted(BAD)


def secret_mesh(folder: Path) -> Path:
    folder.mkdir(parents=True)
    file = folder / "secret.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return file


def robot_with(filename: str) -> Path:
    mesh = f'<visual><geometry><mesh filename="{filename}"/></geometry></visual>'
    file = Path("models/robot/robot.urdf")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(robot(link("a", mesh)))
    return file


def test_meshes_outside_of_the_models_folder_are_not_opened(tmp_path):
    secret = secret_mesh(tmp_path / "private")
    for name in (str(secret), "../../../private/secret.obj", f"file://{secret}", "package://private/secret.obj"):
        file = robot_with(name)
        with pytest.raises(InputError, match="missing"):
            read_articulation(file)
    assert len(read_articulation(file, mesh_folder=secret.parent).links[0].mesh.faces) == 1
    Path("models/robot/link.obj").symlink_to(secret)
    with pytest.raises(InputError, match="missing"):
        read_articulation(robot_with("link.obj"))


def test_a_ros_package_is_one_folder():
    secret_mesh(Path("models/meshes"))
    file = robot_with("package://models/meshes/secret.obj")
    with pytest.raises(InputError, match="missing"):
        read_articulation(file)
    Path("models/package.xml").write_text("<package/>")
    assert len(read_articulation(file).links[0].mesh.faces) == 1


def test_meshes_that_are_found_at_last_are_imported():
    write_microwaves(Path("models"), 1)
    more = '<visual><geometry><mesh filename="more/handle.obj"/></geometry></visual></link>'
    [file] = Path("models").rglob("*.urdf")
    file.write_text(file.read_text().replace("</link>", more, 1))
    Path("elsewhere/more").mkdir(parents=True)

    def said(folder: Path | None) -> list[str]:
        found = import_folder(Path("models"), MICROWAVE, Path("ours"), missing_meshes="skip", mesh_folder=folder)
        return [note.reason for note in found.notes]

    assert "without" in " ".join(said(None))
    assert "without" in " ".join(said(Path("elsewhere")))
    shutil.copy(next(Path("models").rglob("*door*.obj")), "elsewhere/more/handle.obj")
    assert "without" not in " ".join(said(Path("elsewhere")))


def test_a_model_that_was_mended_without_a_byte_more_is_imported_anew(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    category = get_category(SPECS / "microwave.toml")
    write_urdf(microwave("one"), "models/one/one.urdf")
    file, made = Path("models/one/one.urdf"), Path("ours/one/one.urdf")
    text = file.read_text()
    upper = text.split('upper="')[1].split('"')[0]
    for said in ("1." + "0" * (len(upper) - 2), "0." + "5" * (len(upper) - 2)):
        file.write_text(text.replace(f'upper="{upper}"', f'upper="{said}"'))
        assert len(file.read_text()) == len(text)
        os.utime(file, ns=(1, 10**18 + int(10**6 * float(said))))  # some disks keep times to the second alone
        assert import_folder(Path("models"), category, Path("ours")).used == ["one"]
        assert abs(read_urdf(made, category).limits[0, 1] - float(said)) < 1e-6
