"""The bank of surfaces by commands: made for a checkpoint, used by estimates, and exported with it."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import omad
from helpers.command_line import LAPTOP, K, answer, laptop_view, refused, save_png
from omad.cli.main import run
from omad.cli.training import fitted
from omad.cli.training.fitted import surface_text
from omad.evaluation.confidence import surface_shares
from omad.model.checkpoint import find_weights, load, save
from omad.model.priornet import PriorNet
from omad.model.surfaces.bank import FILE
from omad.model.surfaces.surfaces import Surfaces


@pytest.fixture
def weights(tmp_path):
    """A laptop's network alone."""
    folder = tmp_path / "weights"
    folder.mkdir()
    for name in ("config.json", "model.safetensors"):
        shutil.copy(find_weights("laptop") / name, folder)
    return folder


def test_estimates_take_their_surfaces_from_the_bank(weights, capsys):
    observation = laptop_view().observation()
    bare = omad.Estimator.from_pretrained(weights, "cpu")(observation)
    hulls = [len(part.mesh.faces) for part in bare.parts]
    few = ["--objects", "3", "--views", "14", "--threads", "1"]
    made = answer(capsys, "train", "surface", *LAPTOP, "--weights", str(weights), *few)
    assert (made["file"], made["objects"]) == (str(weights / FILE), 3)
    assert len(made["shares"]) == 2
    assert np.shape(made["errors"]) == (3, 2)
    lines = surface_text(omad.get_category("laptop"), made).splitlines()
    assert [line.split("  ")[0] for line in lines[3:5]] == ["base's ends", "hinge"]
    assert re.search(r"hinge +\d+\.\d° ", lines[4])
    assert "was not measured" in surface_text(omad.get_category("laptop"), made | {"shares": None})
    estimate = omad.Estimator.from_pretrained(weights, "cpu")(observation)
    assert [part.name for part in estimate.parts] == ["base", "screen"]
    assert [len(part.mesh.faces) for part in estimate.parts] != hulls
    for part in estimate.parts:
        assert np.allclose(part.mesh.carried(part.T_camera_part).vertices, part.mesh_in_camera.vertices)
        assert len(part.mesh.faces) == len(part.mesh_in_camera.faces)
    exported = answer(capsys, "export", *LAPTOP, "--weights", str(weights), "--output", str(weights / "copy"))
    assert FILE in exported["files"]
    assert (weights / "copy" / FILE).read_bytes() == (weights / FILE).read_bytes()


def test_surfaces_are_made_where_a_confidence_asks_for_those_that_are_not_there(weights, capsys):
    shutil.copy(find_weights("laptop") / "confidence.json", weights)
    few = ["--weights", str(weights), "--objects", "3", "--views", "2", "--threads", "1"]
    assert run(["train", "surface", *LAPTOP, *few]) == 0
    assert "run omad train confidence anew" not in capsys.readouterr().err
    assert run(["train", "surface", *LAPTOP, *few]) == 0
    assert "confidence.json: asks for the surfaces that were there" in capsys.readouterr().err


def test_an_interrupted_measurement_leaves_no_bank_that_looks_finished(weights, monkeypatch, capsys):
    def interrupted(*asked, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(surface_shares, "measured_shares", interrupted)
    assert run(["train", "surface", *LAPTOP, "--weights", str(weights), "--objects", "1", "--views", "1"]) == 130
    assert not (weights / FILE).exists()


def test_where_nothing_can_be_written_is_told_before_anything_is_measured(weights, monkeypatch, capsys):
    def denied(path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(fitted, "unfinished", denied)
    monkeypatch.setattr(surface_shares, "measured_shares", None)
    said = refused(capsys, "train", "surface", *LAPTOP, "--weights", str(weights), "--objects", "1")
    assert "surfaces.npz: cannot be written (Permission denied)" in said


def test_that_shipped_weights_are_changed_is_told(tmp_path, capsys):
    fitted._check_folder_of(None, tmp_path, FILE)
    assert (
        "surfaces.npz: of the shipped weights, is written anew; to keep it, give --weights" in capsys.readouterr().err
    )
    with pytest.raises(omad.InputError, match="is at an address"):
        fitted._check_folder_of(Path("https://here.org/w"), tmp_path, FILE)
    assert not any(tmp_path.iterdir())


def test_the_bank_must_be_of_the_weights_prior_and_models_want_that_in_their_folder(weights, tmp_path, capsys):
    models = tmp_path / "models"
    answer(capsys, "generate", *LAPTOP, "--objects", "1", "--output", str(models))
    prior = load(PriorNet, find_weights("laptop") / "prior")
    prior.prior.learned_basis.mul_(1.1)
    save(prior, tmp_path / "other", {})
    made = ["--weights", str(weights), "--source", str(models)]
    said = refused(capsys, "train", "surface", *LAPTOP, *made, "--prior", str(tmp_path / "other"))
    assert f"other: is not the prior that {weights} was trained with" in said
    assert not (weights / FILE).exists()
    said = refused(capsys, "index", "build", *LAPTOP, *made, "--output", str(tmp_path / "index"))
    assert "prior: is missing; copy there the folder that omad train prior wrote" in said
    shutil.copytree(tmp_path / "other", weights / "prior")
    said = refused(capsys, "index", "build", *LAPTOP, *made, "--output", str(tmp_path / "index"))
    assert f"prior: is not the prior that {weights} was trained with" in said


def test_keypoints_are_those_of_a_prior_or_of_the_one_in_a_checkpoint(capsys):
    few = ["eval", "keypoints", *LAPTOP, "--objects", "2", "--weights"]
    folder = find_weights("laptop")
    assert answer(capsys, *few, str(folder)) == answer(capsys, *few, str(folder / "prior"))


def test_an_export_leaves_nothing_of_one_that_it_replaces(tmp_path, capsys):
    """Here a prior, confidence and bank."""
    bare, output = tmp_path / "bare", tmp_path / "exported"
    bare.mkdir()
    for name in ("config.json", "model.safetensors"):
        shutil.copy(find_weights("microwave") / name, bare / name)
    for options in (LAPTOP, ["--category", "microwave", "--weights", str(bare)]):
        found = answer(capsys, "export", *options, "--output", str(output))
        assert {path.relative_to(output).as_posix() for path in output.rglob("*.*")} == set(found["files"])
    assert set(found["files"]) == {"config.json", "model.safetensors", "prior.npz", "manifest.json"}


def test_weights_are_not_exported_onto_themselves(weights, capsys):
    (weights / FILE).write_bytes(b"its bank")
    said = refused(capsys, "export", *LAPTOP, "--weights", str(weights), "--output", f"{weights}/../weights")
    assert "is where these weights are" in said
    assert (weights / FILE).read_bytes() == b"its bank"


def test_commands_go_on_to_the_surface(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    image, millimetres = save_png("laptop.png"), np.rint(1000 * laptop_view().depth)
    observation = omad.Observation.from_depth(millimetres / 1000, laptop_view().camera)
    seen = omad.Estimator.from_pretrained("laptop", "cpu")(observation)
    expected = seen.to_surface()
    assert not np.allclose(expected.keypoints, seen.keypoints, atol=1e-6)  # laptops go some way
    found = answer(capsys, "estimate", image, *LAPTOP, *K, "--to-surface")
    assert found["joints"][0]["state"] == pytest.approx(expected.joints[0].state, abs=1e-3)
    assert found["seconds"]["surface"] > 0
    pose = ["--objects", "1", "--views", "2"]
    plain, fitted = (answer(capsys, "eval", "pose", *LAPTOP, *pose, *more) for more in ([], ["--to-surface"]))
    assert plain["initial"] == fitted["initial"]
    assert plain["refined"] != fitted["refined"]
    assert "surface" in fitted["seconds"]
    assert "surface" not in plain["seconds"]


def test_the_surface_is_fitted_once_for_all_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    fitted, fits = Surfaces.fitted, []
    monkeypatch.setattr(Surfaces, "fitted", lambda *asked: fits.append(asked) or fitted(*asked))
    answer(capsys, "estimate", save_png("laptop.png"), *LAPTOP, *K, "--formats", "ply")
    assert len(fits) == 1


def test_several_views_do_not_go_each_its_own_way(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.savetxt("pose.txt", np.eye(4))
    image = save_png("laptop.png")
    said = refused(capsys, "estimate", image, *LAPTOP, *K, "--to-surface", "--together", "pose.txt")
    assert "--to-surface" in said


def test_a_bank_that_is_none_is_refused_when_it_is_needed(weights):
    (weights / FILE).write_bytes(b"nothing")
    estimate = omad.Estimator.from_pretrained(weights, "cpu")(laptop_view().observation())
    with pytest.raises(omad.InputError, match=r"surfaces\.npz: .*anew: omad train surface --category laptop"):
        _ = estimate.parts


def test_images_have_no_surfaces_to_compare(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    answer(capsys, "render", *LAPTOP, "--objects", "1", "--views", "1", "--output", "views")
    assert "meshes" in refused(capsys, "eval", "shape", *LAPTOP, "--source", "views")
