"""The bank of surfaces by commands: made for a checkpoint, used by estimates, and exported with it."""

import shutil

import numpy as np
import pytest

import omad
from helpers.command_line import LAPTOP, answer, laptop_view, refused
from omad.model.checkpoint import find_weights
from omad.model.surfaces.bank import FILE


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
    made = answer(capsys, "train", "surface", *LAPTOP, "--weights", str(weights), "--objects", "3", "--threads", "1")
    assert (made["file"], made["objects"]) == (str(weights / FILE), 3)
    estimate = omad.Estimator.from_pretrained(weights, "cpu")(observation)
    assert [part.name for part in estimate.parts] == ["base", "screen"]
    assert [len(part.mesh.faces) for part in estimate.parts] != hulls
    for part, T in zip(estimate.parts, estimate.surface.placed.T_camera_part, strict=True):
        assert np.allclose(part.mesh.carried(T).vertices, part.mesh_in_camera.vertices)
        assert len(part.mesh.faces) == len(part.mesh_in_camera.faces)
    exported = answer(capsys, "export", *LAPTOP, "--weights", str(weights), "--output", str(weights / "copy"))
    assert FILE in exported["files"]
    assert (weights / "copy" / FILE).read_bytes() == (weights / FILE).read_bytes()


def test_a_bank_that_is_none_is_refused_when_it_is_needed(weights):
    (weights / FILE).write_bytes(b"nothing")
    estimate = omad.Estimator.from_pretrained(weights, "cpu")(laptop_view().observation())
    with pytest.raises(omad.InputError, match=r"surfaces\.npz: .*anew: omad train surface --category laptop"):
        _ = estimate.parts


def test_images_have_no_surfaces_to_compare(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    answer(capsys, "render", *LAPTOP, "--objects", "1", "--views", "1", "--output", "views")
    assert "meshes" in refused(capsys, "eval", "shape", *LAPTOP, "--source", "views")
