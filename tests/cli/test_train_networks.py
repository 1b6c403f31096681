"""The trainings of networks on the command line."""

from dataclasses import replace
from pathlib import Path

import pytest

from omad.cli.main import run
from omad.cli.options import check_category
from omad.cli.training import networks
from omad.common.errors import InputError
from omad.model.backbones import BACKBONES, SLIM, BackboneConfig
from omad.model.checkpoint import STATE, save
from omad.model.omadnet import OmadNet
from omad.model.prior import OmadPrior
from omad.objects import category_file
from omad.objects.category_file import get_category

LAPTOP = get_category("laptop")


@pytest.mark.parametrize("command", [networks.TrainNet, networks.TrainAncsh, networks.TrainSiamese])
@pytest.mark.parametrize(("size", "points"), [(None, 512), ("fine", 1024), ("paper", 1024)])
def test_views_have_as_many_points_as_the_backbone_is_shown(monkeypatch, command, size, points):
    asked = []
    monkeypatch.setattr(networks._Training, "learn", lambda self, net, train, settings, **given: asked.append(settings))
    command(category="laptop", output=Path("run"), size=size).run()
    assert isinstance(asked[0].backbone, BackboneConfig)  # no stand-in for one: a checkpoint's record copies it
    assert asked[0].views.points == asked[0].backbone.points == points


def test_the_help_tells_how_long_a_training_goes_on(capsys):
    prior, net = networks.PriorTraining().schedule, networks.NetTraining().schedule
    with pytest.raises(SystemExit):
        run(["train", "net", "--help"])
    assert f"{prior.steps} of a prior, {net.steps} of a network" in " ".join(
        capsys.readouterr().out.replace("│", "").split()
    )


def test_training_goes_on_at_the_size_that_was_begun_unless_another_is_asked_for(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(networks._Training, "learn", lambda self, net, train, settings, **given: asked.append(settings))
    save(OmadNet(LAPTOP, OmadPrior(LAPTOP), BACKBONES["fine"]), tmp_path / "fine", {})
    fine = {"category": "laptop", "output": Path("run"), "initial": str(tmp_path / "fine")}
    networks.TrainNet(**fine).run()
    networks.TrainNet(**fine, size="slim").run()
    assert [settings.backbone for settings in asked] == [BACKBONES["fine"], SLIM]
    with pytest.raises(InputError, match="is not of the size paper; change --size"):
        networks.TrainNet(**fine, size="paper").run()


def test_a_word_that_is_a_category_and_a_folder_is_refused(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(networks._Training, "learn", lambda self, net, train, settings, **given: asked.append(given))
    monkeypatch.chdir(tmp_path)
    save(OmadNet(LAPTOP, OmadPrior(LAPTOP), BACKBONES["fine"]), Path("laptop"), {})
    for option in ("initial", "features"):
        with pytest.raises(InputError, match=rf"--{option} laptop: .* give \./laptop for the folder"):
            networks.TrainNet(category="laptop", output=Path("run"), **{option: "laptop"}).run()
    networks.TrainNet(category="laptop", output=Path("run"), initial="./laptop").run()
    assert asked[0]["initial"].backbone.config == BACKBONES["fine"]


def test_limits_of_a_spec_that_the_weights_do_not_know_are_told_of(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    builtin = (category_file.FOLDER / "laptop.toml").read_text()
    Path("mine.toml").write_text(builtin.replace('"laptop"', '"mine"', 1))
    own = category_file.read_spec("mine.toml")
    check_category("--weights", "here", own, "mine.toml")
    assert capsys.readouterr().err == ""
    narrow = replace(own, joints=(replace(own.joints[0], limits=(0.0, 1.0)),))
    check_category("--weights", "here", narrow, "mine.toml")
    assert "mine.toml: limits changed since --weights here was trained" in capsys.readouterr().err


def test_finished_weights_are_not_trained_over(tmp_path):
    save(OmadNet(LAPTOP, OmadPrior(LAPTOP), BACKBONES["fine"]), tmp_path, {})
    before = (tmp_path / "model.safetensors").read_bytes()
    with pytest.raises(InputError, match="holds finished weights, no training to go on with"):
        networks.TrainNet(category="laptop", output=tmp_path, initial=str(tmp_path)).run()
    assert (tmp_path / "model.safetensors").read_bytes() == before


def test_a_folder_of_another_training_is_refused_before_any_object_is_made(monkeypatch, tmp_path):
    monkeypatch.setattr(networks, "load_objects", None)
    save(OmadNet(LAPTOP, OmadPrior(LAPTOP), BACKBONES["fine"]), tmp_path, {})
    (tmp_path / STATE).touch()
    with pytest.raises(InputError, match="holds a 'net' where a 'prior' is needed"):
        networks.TrainPrior(category="laptop", output=tmp_path).run()
    with pytest.raises(InputError, match=r"--output .* is for laptop, not for scissors"):
        networks.TrainNet(category="scissors", output=tmp_path).run()


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
def test_a_weight_that_is_none_is_refused(weight):
    with pytest.raises(InputError, match="--refinement-loss: must be 0 or more"):
        networks.TrainNet(category="laptop", output=Path("run"), refinement_loss=weight).run()


def test_a_category_without_weights_names_the_option_that_brings_them(capsys):
    assert run(["eval", "pose", "--category", "my_microwave"]) == 2
    assert "give a checkpoint folder (--weights)" in capsys.readouterr().err


@pytest.mark.slow
def test_a_training_that_diverges_fails_in_one_line(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    few = ["--objects", "2", "--batch", "2", "--threads", "1", "--device", "cpu", "--output", "x"]
    assert run(["train", "prior", "--category", "laptop", *few, "--steps", "40", "--learning-rate", "1e9"]) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("omad: ")]
    assert len(lines) == 1
    assert "learning rate" in lines[0]
    assert not Path("x/config.json").exists()
