"""Doubtful answers on the command line: text, JSON, page, exit codes, none of the categories; training confidence."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers.chair import chair_view
from helpers.command_line import LAPTOP, K, answer, laptop_view, refused, save_png
from helpers.confidences import always
from helpers.installed import installed
from omad.cli.main import run
from omad.data.rendering.tabletop import draw_tabletop
from omad.estimation.confidence.model import FILE
from omad.evaluation.confidence import fitting
from omad.model.checkpoint import find_weights, load, save
from omad.model.omadnet import OmadNet
from omad.objects.category_file import get_category
from omad.output.formats import FORMATS, NEED
from omad.sensing.observation import Observation


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def checkpoint(folder: str, probability: float | None) -> list[str]:
    """Options for the laptop's weights, whose answers all have that probability."""
    Path(folder).mkdir()
    for name in ("config.json", "model.safetensors"):
        shutil.copy(find_weights("laptop") / name, Path(folder) / name)
    if probability is not None:
        always(get_category("laptop"), 0.02, 0.1, probability).save(Path(folder))
    return ["--weights", folder]


def test_doubtful_answers_are_called_so_everywhere(capsys):
    image, doubted = save_png("a.png"), checkpoint("doubted", 0.2)
    command = ["estimate", image, *LAPTOP, *K, *doubted, "--formats", "ros"]
    found = answer(capsys, *command, "--strict", code=1)
    assert (found["doubtful"], found["probability"]) == (True, pytest.approx(0.2))
    assert run(command) == 0
    said = capsys.readouterr()
    assert "right with probability 20%, doubtful" in said.out
    assert "doubtful" in said.err
    page = (Path(found["output"]) / "estimate.html").read_text()
    assert '"probability":0.2,"doubtful":true' in page
    assert json.loads((Path(found["output"]) / "ros.json").read_text())["probability"] == found["probability"]
    shutil.copytree(".", "many/", ignore=shutil.ignore_patterns("many", "doubted", "omad-estimate"))
    assert answer(capsys, "estimate", "many", *command[2:], "--strict", code=1)["results"][0]["doubtful"] is True


def test_sure_answers_are_not(capsys):
    image = save_png("a.png")
    found = answer(capsys, "estimate", image, *LAPTOP, *K, *checkpoint("sure", 0.9), "--strict")
    assert (found["doubtful"], found["probability"]) == (False, pytest.approx(0.9))
    found = answer(capsys, "estimate", image, *LAPTOP, *K, *checkpoint("plain", None), "--strict")
    assert (found["doubtful"], found["probability"]) == (False, None)


def test_a_thing_may_be_of_none_of_the_categories(capsys):
    image = save_png("a.png", chair_view().depth)
    command = ["estimate", image, "--category", "auto", *K]
    found = answer(capsys, *command, "--strict", code=1)
    assert (found["category"], found["doubtful"], found["joints"]) == (None, True, [])
    assert found["none"] > max(one["probability"] for one in found["categories"])
    assert found["probability"] is None  # of joints that there are not
    written = json.loads((Path(found["output"]) / "estimate.json").read_text())
    assert written == {key: value for key, value in found.items() if key not in ("input", "output")}
    assert run(command) == 0
    assert "none of the categories (probability" in capsys.readouterr().out
    assert answer(capsys, "estimate", save_png("b.png"), *command[2:])["category"] == "laptop"


def test_an_answer_to_what_is_like_none_of_the_categories_is_doubtful(capsys):
    for seed in range(3):
        image = save_png(f"{seed}.png", chair_view(seed).depth)
        found = answer(capsys, "estimate", image, *LAPTOP, *K, "--compare", "--strict", code=1)
        assert found["none"] > 0.8
        assert found["probability"] < 0.1
        assert "category" in {check["name"] for check in found["checks"]}


def test_none_of_the_categories_has_every_key_and_leaves_no_earlier_answer(capsys):
    first = answer(capsys, "estimate", save_png("a.png"), "--category", "auto", *K, "--formats", "ros", "glb", "ply")
    assert first["category"] == "laptop"
    command = ["estimate", save_png("a.png", chair_view().depth), "--category", "auto", *K]
    found = answer(capsys, *command)
    assert found["category"] is None
    assert set(found) == set(first) - {"world"}
    for key in ("T_camera_base", "residual", "initial", "mirrored", "hand_probability"):
        assert found[key] is None
    assert (found["beta"], found["keypoints"], found["parts"]) == ([], [], [])
    assert set(found["seconds"]) == set(first["seconds"])
    left = {file.name for file in Path(found["output"]).iterdir() if file.is_file()}
    assert left == {"estimate.json"}


def test_an_answer_leaves_no_files_of_an_earlier_one(capsys):
    """Of other formats, or of an object with other parts; what is not of the answer stays."""
    command = ["estimate", save_png("a.png"), *LAPTOP, *K]
    folder = Path(answer(capsys, *command)["output"])
    alone = {file.relative_to(folder) for file in folder.rglob("*")}
    formats = [name for name in FORMATS if name not in NEED or installed(NEED[name][0])]
    answer(capsys, *command, "--formats", *formats)
    assert len({file.relative_to(folder) for file in folder.rglob("*")} - alone) > len(formats)
    record = json.loads((folder / "estimate.json").read_text())
    record["parts"].append({"name": "lid.1"})
    (folder / "estimate.json").write_text(json.dumps(record))
    of_another = ["part-lid.1.ply", "meshes/object-2-lid_1.obj", "meshes/robot-2-lid_1-body-0.obj"]
    not_ours = ["notes.txt", "part-mine.ply", "part-screen.txt", "meshes/object-mine.obj", "meshes/0-screen.obj"]
    for name in of_another + not_ours:
        (folder / name).touch()
    answer(capsys, *command)
    left = {file.relative_to(folder) for file in folder.rglob("*")}
    assert left == alone | {Path(name) for name in not_ours}


def test_files_beside_a_first_answer_are_not_taken_for_an_earlier_ones(capsys):
    Path("omad-estimate/a").mkdir(parents=True)
    mine = [Path("omad-estimate/a") / name for name in ("object.ply", "part-screen.ply", "ros.json")]
    for file in mine:
        file.touch()
    answer(capsys, "estimate", save_png("a.png"), *LAPTOP, *K)
    assert all(file.is_file() for file in mine)


def test_an_object_that_a_format_cannot_say_is_refused_and_the_others_are_written(capsys):
    pytest.importorskip("pxr", reason="USD is an extra: pip install 'omad[usd]'")
    net = load(OmadNet, find_weights("laptop"))
    hinge = replace(net.category.joints[0], type="screw", pitch=1e-3)
    net.category = replace(net.category, joints=(hinge,))
    save(net, Path("own"), {})
    images = [save_png("laptop.png"), save_png("chair.png", chair_view().depth)]
    command = ["estimate", *images, "--category", "auto", "--weights", "own", *K, "--formats", "usd"]
    found = answer(capsys, *command, code=2)
    assert [(result["input"], result["category"]) for result in found["results"]] == [("chair.png", None)]
    assert "laptop.png" in found["refused"][0]["reason"]
    assert "turns and slides at once" in found["refused"][0]["reason"]
    assert {file.name for file in Path("omad-estimate").iterdir()} == {"chair"}


def test_a_category_of_ones_own_is_tried_beside_the_shipped_ones(capsys):
    net = load(OmadNet, find_weights("laptop"))
    net.category = replace(net.category, name="notebook")
    save(net, Path("own"), {})
    found = answer(capsys, "estimate", save_png("a.png"), "--category", "auto", "--weights", "own", *K)
    assert {"notebook", "laptop"} <= {one["category"] for one in found["categories"]}


def test_detect_names_a_wrong_depth_scale(capsys):
    scene = draw_tabletop(("laptop",), (2, 5))
    image = save_png("table.png", scene.depth)
    found = answer(capsys, "detect", image, *K, "--categories", "laptop", "--depth-scale", "0.0001")
    assert not any(one["category"] for one in found["objects"])
    assert [warning for warning in found["warnings"] if warning.endswith("10 times too small; --depth-scale 0.001")]
    Image.fromarray(np.full((480, 640), 900, np.uint16)).save("wall.png")
    assert answer(capsys, "detect", "wall.png", *K, "--categories", "laptop")["support_plane"] is not None
    assert run(["detect", "wall.png", *K, "--categories", "laptop"]) == 0
    assert "Nothing stands before table, floor and walls" in capsys.readouterr().out


def test_the_object_of_a_whole_cloud_is_found_as_that_of_a_whole_image_is(capsys):
    scene = draw_tabletop(("laptop",), (2, 5))
    true = np.concatenate([one.states for one in scene.objects if one.category == "laptop"])
    np.save("scene.npy", Observation.from_depth(scene.depth, scene.camera).points)
    for options in ([save_png("table.png", scene.depth), *K], ["scene.npy"]):
        found = answer(capsys, "estimate", *options, *LAPTOP)
        assert np.abs(found["joints"][0]["state"] - true).min() < np.radians(5)
        assert any("omad detect gives them all" in warning for warning in found["warnings"])
        assert sum(part["points"] for part in found["parts"]) < 0.2 * np.count_nonzero(scene.depth)
    laptop = Observation.from_depth(laptop_view().depth, laptop_view().camera)
    np.save("laptop.npy", laptop.points)
    alone = answer(capsys, "estimate", "laptop.npy", *LAPTOP)
    assert sum(part["points"] for part in alone["parts"]) > 0.95 * len(laptop.points)


def test_an_id_without_a_mask_is_refused(capsys):
    assert "--mask-id 3: tells one" in refused(capsys, "estimate", save_png("a.png"), *LAPTOP, *K, "--mask-id", "3")


@pytest.mark.slow
def test_confidence_is_trained_into_the_checkpoint(capsys, monkeypatch):
    """The second training has the answers of the first: the same seed draws the same views."""
    answers, answered = {}, fitting.answered

    def answered_once(estimator, models, views, seed, begun):
        if (views, seed) not in answers:
            answers[views, seed] = answered(estimator, models, views, seed, begun)
        return answers[views, seed]

    monkeypatch.setattr(fitting, "answered", answered_once)
    monkeypatch.setattr(fitting, "FEWEST", 30)
    monkeypatch.setattr(fitting, "STEPS", 60)
    weights = checkpoint("own", None)
    trained = ["train", "confidence", *LAPTOP, *weights, "--objects", "5"]
    assert "give more" in refused(capsys, *trained, "--views", "8")
    found = answer(capsys, *trained, "--views", "90")
    assert found["checkpoint"] == "own"
    assert 0.7 < found["covered_90"] <= 1
    image = save_png("a.png")
    first = answer(capsys, "estimate", image, *LAPTOP, *K, *weights)
    assert first["probability"] > 0.5
    kept = (Path("own") / FILE).read_text()
    exported = answer(capsys, "export", *LAPTOP, *weights, "--output", "exported")
    assert FILE in exported["files"]
    second = answer(capsys, "estimate", image, *LAPTOP, *K, "--weights", "exported")
    assert second["probability"] == pytest.approx(first["probability"])
    (Path("own") / FILE).write_text("{")
    assert str(Path("own") / FILE) in refused(capsys, "estimate", image, *LAPTOP, *K, *weights)
    answer(capsys, *trained, "--views", "90")  # the cure that is named
    assert (Path("own") / FILE).read_text() == kept


@pytest.mark.slow
def test_a_wrong_depth_scale_is_doubted(capsys):
    found = answer(capsys, "estimate", save_png("d.png"), *LAPTOP, *K, "--depth-scale", "1e-4")
    assert "depth scale" in found["warnings"][0]


def test_one_doubtful_answer_of_many_is_enough_for_strict(capsys):
    save_png("many/laptop.png")
    assert answer(capsys, "estimate", "many", *LAPTOP, *K, "--strict")["results"][0]["doubtful"] is False
    save_png("many/vast.png", 6 * laptop_view().depth)
    found = answer(capsys, "estimate", "many", *LAPTOP, *K, "--strict", code=1)
    assert sorted(one["doubtful"] for one in found["results"]) == [False, True]
