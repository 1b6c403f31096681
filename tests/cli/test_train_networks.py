"""The trainings of networks on the command line."""

from pathlib import Path

import pytest

from omad.cli.training import networks


@pytest.mark.parametrize("command", [networks.TrainNet, networks.TrainAncsh, networks.TrainSiamese])
@pytest.mark.parametrize(("size", "points"), [("slim", 512), ("paper", 1024)])
def test_views_have_as_many_points_as_the_backbone_is_shown(monkeypatch, command, size, points):
    asked = []
    monkeypatch.setattr(networks._Training, "learn", lambda self, train, settings, **given: asked.append(settings))
    command(category="laptop", output=Path("run"), size=size).run()
    assert asked[0].views.points == asked[0].backbone.points == points
