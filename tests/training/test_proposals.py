"""Training the network that proposes categories: it learns, begins with features, and gives the same again."""

from dataclasses import replace

import pytest
import torch

from omad.data.procedural import generate
from omad.data.training_views import ViewSettings
from omad.model.backbones import SLIM
from omad.model.checkpoint import find_weights, load
from omad.model.omadnet import OmadNet
from omad.model.proposals.network import ProposalNet
from omad.objects.category_file import get_category
from omad.training.train_proposals import ProposalTraining, train_proposals

CATEGORIES = [get_category(name) for name in ("laptop", "safe")]
SHORT = ProposalTraining(strangers=6)


def trained(folder, steps: int, seed: int = 0, features: OmadNet | None = None, batch: int = 8) -> ProposalNet:
    models = [[generate(category, index) for index in range(2)] for category in CATEGORIES]
    schedule = replace(SHORT.schedule, steps=steps, batch=batch, seed=seed, log_steps=1)
    return train_proposals(models, CATEGORIES, folder, replace(SHORT, schedule=schedule), "cpu", features)


def test_the_same_seed_gives_the_same_network(tmp_path):
    one, other, another = (trained(tmp_path / name, 2, seed) for name, seed in (("a", 0), ("b", 0), ("c", 1)))
    assert one.names == ("laptop", "safe")
    weights = [net.state_dict() for net in (one, other, another)]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
    assert not all(torch.equal(weights[0][name], weights[2][name]) for name in weights[0])


def test_it_begins_with_what_a_network_knows_of_clouds(tmp_path):
    features = load(OmadNet, find_weights("laptop"))
    net = trained(tmp_path, 1, features=features)
    for name, tensor in net.backbone.state_dict().items():
        assert torch.allclose(tensor, features.backbone.state_dict()[name], atol=0.01)


def test_a_batch_has_as_many_views_as_it_is_asked_for(tmp_path, monkeypatch):
    seen, forward = [], ProposalNet.forward
    monkeypatch.setattr(ProposalNet, "forward", lambda net, points: seen.append(len(points)) or forward(net, points))
    trained(tmp_path, 1, batch=6)
    assert seen == [6]


def test_another_one_knows_what_both_tell():
    one, other = ProposalNet(("a", "b", "c")).eval(), ProposalNet(("c", "new", "a")).eval()
    fresh = other.head[-1].weight.clone()
    other.start_from(one)
    points = torch.randn(2, SLIM.points, 3)
    before, after = one(points), other(points)
    assert torch.equal(after[:, [0, 2, 3]], before[:, [2, 0, 3]])
    assert torch.equal(other.head[-1].weight[1], fresh[1])


@pytest.mark.slow
def test_it_learns_to_tell_two_categories_and_strangers(tmp_path):
    views = ViewSettings(noise=0.0)
    schedule = replace(SHORT.schedule, steps=60, batch=32, average=0.9, log_steps=1)
    models = [[generate(category, index) for index in range(4)] for category in CATEGORIES]
    settings = replace(SHORT, schedule=schedule, views=views, strangers=12)
    train_proposals(models, CATEGORIES, tmp_path, settings, "cpu", load(OmadNet, find_weights("laptop")))
    losses = [line.split('"category": ')[1] for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    last = [float(loss.rstrip("}")) for loss in losses[-5:]]
    assert sum(last) / 5 < 0.5  # by chance 1.0
