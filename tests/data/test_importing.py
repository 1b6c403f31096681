"""omad import: what fits comes out canonical and unchanged in shape, what does not is named with the reason."""

import json
import os
import shlex
import shutil
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import KDTree

import omad
from helpers.categories import CATEGORIES, EVERY
from helpers.command_line import answer, refused
from helpers.own_models import SPECS, Z_UP, box, microwave, seen_from_elsewhere, stapler, write_microwaves
from omad.cli.main import run
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.data.rendering.view_folder import open_views
from omad.data.urdf_import import importing
from omad.data.urdf_import.articulation import read_articulation, read_urdf
from omad.data.urdf_import.folder import import_model, load_folder
from omad.data.urdf_import.importing import import_folder
from omad.geometry.mesh import Mesh
from omad.objects.category import Category
from omad.objects.model import ObjectModel
from omad.objects.urdf import write_urdf
from omad.output.contact_sheet import contact_sheet, picture

MICROWAVE, STAPLER = (omad.get_category(SPECS / f"{name}.toml") for name in ("microwave", "stapler"))
DRAWER = CATEGORIES["drawer"]
MODELS = Path(os.environ.get("OMAD_MODELS", "nowhere"))
needs_models = pytest.mark.skipif(not MODELS.is_dir(), reason="OMAD_MODELS names no folder of real models")
WITH = ["--category", str(SPECS / "microwave.toml")]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def largest_move(a: ObjectModel, b: ObjectModel, seed: int = 0) -> float:
    """Largest distance between the same point of two models at random joint states, as a share of their size."""
    states = np.random.default_rng(seed).uniform(a.limits[:, 0], a.limits[:, 1], (3, len(a.limits)))
    gaps = [
        KDTree(ours).query(theirs)[0].max()
        for state in states
        for ours, theirs in zip(a.posed_vertices(state), b.posed_vertices(state), strict=True)
    ]
    return float(max(gaps)) / a.diagonal


def assert_survives(model: ObjectModel, category: Category, folder: Path) -> None:
    """Our writer and both of our readers bring the model back."""
    file = write_urdf(model, folder)
    back = read_urdf(file, category)
    for one, other in zip(model.parts, back.parts, strict=True):
        np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-9)  # the same points in the same order
    for again in (back, import_model(file, category)):
        assert largest_move(model, again) < 1e-5
        np.testing.assert_allclose(again.limits, model.limits, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_procedural_objects_survive_the_round_trip(name, tmp_path):
    """As a person's own import: ours is canonical already, and stays as it stands."""
    category = EVERY[name]
    for index in range(4):
        assert_survives(generate(category, index, "test"), category, tmp_path / str(index))


@pytest.mark.parametrize(("model", "category"), [(microwave(), MICROWAVE), (stapler(), STAPLER)])
def test_own_categories_survive_the_round_trip(model, category, tmp_path):
    assert_survives(model, category, tmp_path / "ours")
    states = 0.4 * model.limits[:, 1]
    found = import_model(write_urdf(seen_from_elsewhere(model, states), tmp_path / "theirs"), category)
    assert largest_move(model, found) < 1e-9
    assert_survives(found, category, tmp_path / "back")


FITTING = [
    *(("dishwasher", name) for name in ("11622", "11826", "12259")),
    *(("eyeglasses", name) for name in ("101284", "101287")),
    *(("microwave", name) for name in ("7119", "7128", "7167")),
    *(("stapler", name) for name in ("103100", "103104")),
    ("drawer", "mk_station"), ("laptop", "arctic"), ("scissors", "10495"),
]  # fmt: skip


def category_of(name: str) -> Category:
    return {"microwave": MICROWAVE, "stapler": STAPLER}.get(name) or EVERY[name]


@pytest.mark.slow
@needs_models
@pytest.mark.parametrize(("kind", "name"), FITTING)
def test_real_models_survive_the_round_trip(kind, name, tmp_path):
    category = category_of(kind)
    assert_survives(import_model(MODELS / kind / name, category), category, tmp_path / "back")


@pytest.mark.slow
@needs_models
@pytest.mark.parametrize(("kind", "name"), FITTING)
def test_real_models_of_another_category_are_refused(kind, name):
    """PartNet-Mobility's say what they are; the others are told by their shape and joints."""
    for category in (*CATEGORIES.values(), MICROWAVE, STAPLER):
        if category != category_of(kind):
            with pytest.raises(InputError):
                import_model(MODELS / kind / name, category)


@needs_models
def test_real_models_that_do_not_fit_are_refused_with_the_reason():
    drawers = {refusal.name: refusal.reason for refusal in load_folder(MODELS / "drawer", DRAWER).refused}
    assert ".obj" in drawers["23724"]
    assert "drawer" in drawers["45261"]
    assert len(drawers) == 2


@needs_models
def test_hinges_of_edited_files_come_from_where_they_were_stated():
    """The staplers' URDFs have every joint at the origin; another file of theirs still has the right ones."""
    moved = import_model(MODELS / "stapler/103104", STAPLER)
    shutil.copytree(MODELS / "stapler/103104", "whole")
    shutil.move("whole/mobility_original.urdf", "whole/mobility.urdf")
    assert largest_move(import_model("whole", STAPLER), moved) < 1e-6


# The frame -----------------------------------------------------------------------------------------------------------


def chest(y_up: bool = False) -> ObjectModel:
    """Three drawers of unequal heights in a cabinet with a foot, in its source's frame: z up unless told otherwise."""
    heights = ((0.5, 0.7), (0.25, 0.48), (0.03, 0.23))
    drawers = [box((-0.2, low, -0.19), (0.2, high, 0.21)) for low, high in heights]
    canonical = ObjectModel(
        name="chest",
        category="drawer",
        part_names=tuple(part.name for part in DRAWER.parts),
        parts=(box((-0.22, 0, -0.2), (0.22, 0.72, 0.2)), *drawers),
        joint_names=tuple(joint.name for joint in DRAWER.joints),
        tree=DRAWER.tree,
        axes=np.tile([0.0, 0.0, 1.0], (3, 1)),
        pivots=np.zeros((3, 3)),
        limits=np.tile([0.0, 0.3], (3, 1)),
    ).centred()
    R = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]) if y_up else Z_UP
    return replace(
        canonical,
        parts=tuple(Mesh(part.vertices @ R.T + (0, 0, 0.36), part.faces) for part in canonical.parts),
        axes=canonical.axes @ R.T,
    )


@pytest.mark.parametrize("y_up", [False, True])
def test_a_chest_of_drawers_stands_upright_whichever_axis_its_source_has_up(y_up, tmp_path):
    model = import_model(write_urdf(chest(y_up), tmp_path), DRAWER)
    boxes = model.part_boxes()
    assert np.all(np.diff(boxes[1:].mean(1)[:, 1]) < 0)  # from top to bottom
    assert np.ptp(boxes[1], axis=0)[1] == pytest.approx(0.2)  # as high as the upper one was made
    opened = np.concatenate(model.posed_vertices(model.limits[:, 1]))
    assert opened[:, 2].max() > boxes[0, 1, 2] + 0.25


@needs_models
def test_the_real_chest_of_drawers_stands_upright(tmp_path):
    """Its table top is the only thing at one end of its height."""
    model = import_model(MODELS / "drawer/mk_station", DRAWER)
    raw = read_articulation(MODELS / "drawer/mk_station/mk_station.urdf")
    top = raw.links[[link.name for link in raw.links].index("top_drawer")].mesh
    assert model.part_boxes()[1].mean(0)[1] > 0.1
    assert np.ptp(model.parts[1].vertices, axis=0)[1] == pytest.approx(np.ptp(top.vertices, axis=0)[2])
    assert np.all(model.posed_vertices(model.limits[:, 1])[1][:, 2].max() > model.part_boxes()[0, 1, 2])


# The command ---------------------------------------------------------------------------------------------------------


def edit(file: str, change) -> None:
    tree = ElementTree.parse(file)
    change(tree.getroot())
    tree.write(file)


def second_door(root) -> None:
    for name in ("link", "joint"):
        twin = ElementTree.fromstring(ElementTree.tostring(root.findall(name)[-1]))
        twin.set("name", "door-2")
        root.append(twin)
    root.findall("joint")[-1].find("child").set("link", "door-2")


def no_joint(root) -> None:
    root.find("joint").set("type", "fixed")


def partnet(name: str, model_cat: str) -> None:
    """A microwave as PartNet-Mobility has it, of a stated category."""
    ours = seen_from_elsewhere(microwave(name), np.array([0.5]))
    scaled = [Mesh(part.vertices / MICROWAVE.metres_per_unit, part.faces) for part in ours.parts]
    model = replace(ours, parts=tuple(scaled), pivots=ours.pivots / MICROWAVE.metres_per_unit)
    write_urdf(model, Path("models") / name / "mobility.urdf")
    Path("models", name, "meta.json").write_text(json.dumps({"model_cat": model_cat}))


@pytest.fixture
def mixed() -> None:
    """A folder of models, of which four do not fit."""
    write_microwaves(Path("models"), 4)
    edit("models/oven-0-1/oven-0-1.urdf", second_door)
    edit("models/oven-0-2/oven-0-2.urdf", no_joint)
    next(Path("models/oven-0-3/meshes").glob("*door*")).unlink()
    partnet("1001", "Microwave")
    partnet("1002", "Oven")


def test_a_folder_of_models_becomes_training_data(mixed, capsys):
    found = answer(capsys, "import", "models", *WITH, "--output", "ours")
    assert found["used"] == ["1001", "oven-0-0"]
    assert found["models"] == 6
    reasons = {refusal["name"]: refusal["reason"] for refusal in found["refused"]}
    assert sorted(reasons) == ["1002", "oven-0-1", "oven-0-2", "oven-0-3"]
    assert "'Oven'" in reasons["1002"]
    assert "source_names" in reasons["1002"]
    assert "door" in reasons["oven-0-1"]
    assert "revolute" in reasons["oven-0-2"]
    assert "door.obj" in reasons["oven-0-3"]
    assert all("\n" not in reason for reason in reasons.values())
    assert sorted(found["reasons"].values()) == [1, 1, 1, 1]
    assert Image.open(found["picture"]).size[0] > 300
    models = load_folder("ours", MICROWAVE).models
    assert [model.name for model in models] == found["used"]
    assert not load_folder("ours", MICROWAVE).refused
    assert largest_move(models[0], microwave()) < 1e-6
    summary = json.loads(Path("ours/import.json").read_text())["summary"]
    assert summary["used"] == found["used"]
    assert summary["refused"] == found["refused"]


def test_a_person_reads_the_summary(mixed, capsys):
    assert run(["import", "models", *WITH, "--output", "ours"]) == 0
    text = capsys.readouterr().out
    assert "2 of 6" in text
    assert "ours/models.png" in text


def test_a_name_that_the_spec_knows_is_no_other_category(mixed):
    wider = replace(MICROWAVE, source_names=("oven",))
    assert "1002" in import_folder(Path("models"), wider, Path("ours")).used


def test_an_interrupted_import_goes_on(mixed, monkeypatch):
    imported, calls = importing.import_with_notes, []

    def counted(path, *options):
        calls.append(path.name)
        return imported(path, *options)

    def stopping(path, *options):
        if path.name == "oven-0-0":
            raise KeyboardInterrupt
        return imported(path, *options)

    monkeypatch.setattr(importing, "import_with_notes", stopping)
    with pytest.raises(KeyboardInterrupt):
        import_folder(Path("models"), MICROWAVE, Path("ours"))
    monkeypatch.setattr(importing, "import_with_notes", counted)
    first = import_folder(Path("models"), MICROWAVE, Path("ours"))
    assert "1001" not in calls  # it was done before
    calls.clear()
    again = import_folder(Path("models"), MICROWAVE, Path("ours"))
    assert again.to_dict() == first.to_dict()
    assert not {"1001", "oven-0-0"} & set(calls)


def test_changed_and_removed_models_are_done_again(mixed):
    import_folder(Path("models"), MICROWAVE, Path("ours"))
    write_urdf(microwave("oven-0-0", width=0.6), "models/oven-0-0/oven-0-0.urdf")
    shutil.rmtree("models/1001")
    shutil.copytree("models/oven-0-0", "models/oven-0-3", dirs_exist_ok=True)
    Path("models/oven-0-3/oven-0-3.urdf").unlink()
    found = import_folder(Path("models"), MICROWAVE, Path("ours"))
    assert found.used == ["oven-0-0", "oven-0-3"]
    assert [model.name for model in load_folder("ours", MICROWAVE).models] == found.used
    assert load_folder("ours", MICROWAVE).models[0].part_boxes()[0, 1, 0] == pytest.approx(0.3)


def test_missing_meshes_may_be_done_without(mixed, capsys):
    Path("models/oven-0-3/meshes/oven-0-3-0-body.obj").rename("body.obj")
    line = refused(capsys, "import", "models/oven-0-3", *WITH, "--output", "ours", "--missing-meshes", "skip")
    assert "oven-0-3" in line


def test_what_is_odd_about_a_model_is_noted(capsys):
    write_microwaves(Path("models"), 1)
    [model] = sorted(Path("models").iterdir())
    made = answer(capsys, "import", str(model), *WITH, "--output", "large", "--scale", "1000")
    assert not made["notes"]
    assert "m across" in made["warnings"][0]["reason"]
    assert "--scale 1 " in made["warnings"][0]["reason"]
    with pytest.raises(InputError, match=r" m across.* --scale 1 "):
        import_model(model, MICROWAVE, scale=1000.0)
    write_urdf(microwave().stretched(np.full(3, 1000.0)), "partnet/1/mobility.urdf")  # not normalised
    [doubt] = answer(capsys, "import", "partnet", *WITH, "--output", "normalised")["warnings"]
    assert "--scale 0.0003 (metres per unit of its file) makes it 0.201 m" in doubt["reason"]
    assert load_folder("partnet", MICROWAVE, scale=0.0003).models[0].diagonal == pytest.approx(0.201, abs=1e-3)
    line = refused(capsys, "render", *WITH, "--source", "large", "--output", "views", "--views", "1")
    assert " m across, where metres_per_unit of my_microwave is " in line
    cure = shlex.split(line[line.index("omad import ") : line.index(" (metres per unit")])[1:]  # is a whole command
    assert run([WITH[1] if word == "SPEC.toml" else word for word in cure]) == 0
    assert load_folder("imported", MICROWAVE).models[0].diagonal < 1
    capsys.readouterr()
    file = next(model.glob("*.urdf"))
    lost = '<visual><geometry><mesh filename="lost.obj"/></geometry></visual>'
    file.write_text(file.read_text().replace("</link>", f"{lost}</link>", 1))
    made = answer(capsys, "import", str(model), *WITH, "--output", "ours", "--missing-meshes", "skip")
    assert "without 1 of its mesh files" in made["notes"][0]["reason"]


def test_models_of_the_other_hand_stay_known_as_such(capsys):
    """In what is imported of them, in what commands say on stderr, in rendered data sets, however often imported."""
    category = EVERY["microwave"]
    for name, model in (("own", generate(category, 0)), ("image", generate(category, 1).mirrored())):
        write_urdf(replace(model, name=name), f"models/{name}/{name}.urdf")
    first = import_folder(Path("models"), category, Path("ours"))
    for source, again in (("models", "again"), ("ours", "once more")):
        found, imported = load_folder(source, category), import_folder(Path(source), category, Path(again))
        for models, notes in ((found.models, found.notes), (imported.models, imported.notes)):
            assert [(model.name, model.of_other_hand) for model in models] == [("image", True), ("own", False)]
            assert [(note.name, note.reason) for note in notes] == [("image", first.notes[0].reason)]
    assert load_folder("ours/image", category).models[0].of_other_hand
    Path("ours/import.json").write_text('{"notes": [3]}')
    assert not load_folder("ours", category).notes
    capsys.readouterr()
    for views in ("2", "3"):
        made = ["render", "--category", "microwave", "--source", "models", "--output", "views", "--views", views]
        assert run(made) == 0
    assert capsys.readouterr().err.count("note on image: is the other way round") == 1
    truths = {view.object: view.truth for view in open_views("views")}
    assert {name: truth.of_other_hand for name, truth in truths.items()} == {"own": False, "image": True}
    assert "of_other_hand" not in Path("views/own/object.json").read_text()
    record = json.loads(Path("views/image/object.json").read_text())
    del record["of_other_hand"]  # as an earlier version wrote it
    Path("views/image/object.json").write_text(json.dumps(record))
    assert run([*made[:-1], "4"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["gone", *WITH, "--output", "ours"], "gone: "),
        (["empty", *WITH, "--output", "ours"], "empty: "),
        (["models", *WITH, "--output", "models"], "models: "),
        (["models", *WITH, "--output", "full"], "full: "),
        (["models", *WITH, "--output", "file"], "file: "),
        (["models", *WITH, "--output", "ours", "--scale", "0"], "--scale 0.0: "),
        (["models", "--category", "toaster", "--output", "ours"], "'toaster'"),
    ],
)
def test_bad_input_is_refused_in_one_line(words, message, capsys):
    write_microwaves(Path("models"), 1)
    Path("empty").mkdir()
    Path("full").mkdir()
    Path("full/letter.txt").write_text("mine")
    Path("file").write_text("mine")
    assert message in refused(capsys, "import", *words)


def test_a_folder_of_another_import_is_left_alone(capsys):
    write_microwaves(Path("models"), 1)
    write_microwaves(Path("others"), 1)
    assert run(["import", "models", *WITH, "--output", "ours"]) == 0
    assert "source" in refused(capsys, "import", "others", *WITH, "--output", "ours")
    assert "scale" in refused(capsys, "import", "models", *WITH, "--output", "ours", "--scale", "2")
    Path("ours/import.json").write_text("{")
    assert "import.json: " in refused(capsys, "import", "models", *WITH, "--output", "ours")


def test_below_each_model_on_a_sheet_it_is_open_as_far_as_it_goes():
    models = [generate(CATEGORIES["drawer"], index, "test") for index in range(2)]
    panels = contact_sheet(models).axes
    assert [panel.get_title() for panel in panels[:2]] == [model.name for model in models]
    for column, model in enumerate(models):
        rest, moved = (panels[row * 2 + column].images[0].get_array() for row in (0, 1))
        assert np.array_equal(rest, picture(model, np.zeros(3)))
        assert np.array_equal(moved, picture(model, model.limits[:, 1]))
        assert not np.array_equal(rest, moved)
