"""The network that proposes categories: what it keeps, what it says, and how small it is."""

import json

import numpy as np
import pytest
import torch
from safetensors import safe_open

import omad
from omad.common.errors import InputError
from omad.data.procedural import GENERATORS
from omad.model.backbones import SLIM
from omad.model.checkpoint import CHECKSUM, load, save
from omad.model.omadnet import OmadNet
from omad.model.proposals.network import WEIGHTS, ProposalNet, Proposer, shipped_proposer


def cloud(seed: int, size: float = 0.3) -> omad.Observation:
    points = size * np.random.default_rng(seed).normal(size=(3000, 3)) + [0, 0, 6 * size]
    return omad.Observation.from_points(points.astype(np.float32))


def test_a_checkpoint_gives_the_same_network(tmp_path):
    net = ProposalNet(("a", "b", "c")).eval()
    save(net, tmp_path, {"why": "test"})
    again = load(ProposalNet, tmp_path)
    assert again.names == ("a", "b", "c")
    points = torch.randn(2, SLIM.points, 3)
    assert torch.equal(again(points), net(points))
    with pytest.raises(InputError, match="'net' is needed"):
        load(OmadNet, tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**config, "names": 3}))
    with pytest.raises(InputError, match=r"config\.json"):
        load(ProposalNet, tmp_path)


def test_all_categories_and_none_share_one():
    net = ProposalNet(("a", "b")).eval()
    for found in Proposer(net)([cloud(0), cloud(1)]):
        assert set(found) == {"a", "b", None}
        assert sum(found.values()) == pytest.approx(1, abs=1e-5)
        assert list(found.values()) == sorted(found.values(), reverse=True)
    assert Proposer(net)([]) == []


def test_several_clouds_are_answered_as_each_alone():
    clouds = [cloud(seed) for seed in range(3)]
    together = shipped_proposer()(clouds)
    for one, found in zip(clouds, together, strict=True):
        [alone] = shipped_proposer()([one])
        assert alone == pytest.approx(found, abs=1e-4)


def test_where_a_cloud_is_does_not_matter_but_its_size_does():
    net = ProposalNet(("a", "b")).eval()
    points = 0.1 * torch.randn(1, SLIM.points, 3)
    assert torch.allclose(net(points), net(points + torch.tensor([0.3, -0.2, 2.0])), atol=1e-4)
    assert not torch.allclose(net(points), net(3 * points), atol=1e-4)


def test_what_is_pooled_is_what_the_features_hold():
    backbone = SLIM.build().eval()
    points = torch.randn(2, SLIM.points, 3)
    assert torch.equal(backbone.pooled(points), backbone(points).pooled)


def test_the_shipped_one_is_small_and_knows_all_that_is_generated():
    assert set(shipped_proposer().net.names) == set(GENERATORS)
    path = WEIGHTS / "model.safetensors"
    assert path.stat().st_size < 2.2e6
    with safe_open(path, "np") as file:
        assert len(file.metadata()[CHECKSUM]) == 64
