"""Training: it learns, it resumes exactly, it refuses what is not its own."""

import json
import re
from dataclasses import replace

import pytest
import torch
from torch import nn

from helpers.categories import EYEGLASSES, LAPTOP
from omad.common.errors import InputError
from omad.data.procedural import generate
from omad.model.omadnet import OmadNet
from omad.model.priornet import PriorNet
from omad.training.loop import Schedule, train
from omad.training.refined_error import FAR
from omad.training.train_net import NetLossWeights, NetTraining, train_net
from omad.training.train_prior import PriorTraining, train_prior

SCHEDULE = Schedule(steps=40, batch=8, log_steps=10)


class Line(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(2, 1)


def terms(model, generator, stop_at=None, counter=None):
    if counter is not None:
        counter.append(1)
        if len(counter) == stop_at:
            raise KeyboardInterrupt
    x = torch.randn(8, 2, generator=generator)
    return {"fit": (model.layer(x) - x.sum(1, keepdim=True)).square().mean()}


def fresh() -> Line:
    torch.manual_seed(0)
    return Line()


@pytest.mark.slow
def test_loss_goes_down_and_metrics_are_written(tmp_path):
    train(fresh(), terms, replace(SCHEDULE, learning_rate=0.05, steps=200), tmp_path, {})
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(10, 201, 10))
    assert rows[-1]["fit"] < 0.05 * rows[0]["fit"]
    assert list(tmp_path.glob("events.out.tfevents.*"))


def test_a_killed_training_goes_on_exactly(tmp_path):
    whole, model = fresh(), fresh()
    kept = train(whole, terms, SCHEDULE, tmp_path / "whole", {})
    often = replace(SCHEDULE, save_seconds=0.0)
    count = []
    with pytest.raises(KeyboardInterrupt):
        train(model, lambda m, g: terms(m, g, 25, count), often, tmp_path / "killed", {})
    resumed = train(fresh(), terms, often, tmp_path / "killed", {})
    assert torch.equal(resumed.layer.weight, kept.layer.weight)
    steps = [json.loads(line)["step"] for line in (tmp_path / "killed/metrics.jsonl").read_text().splitlines()]
    assert steps == [10, 20, 30, 40]


def test_what_drops_out_is_the_same_after_a_kill(tmp_path):
    def dropped(model, generator, stop_at=None, counter=None):
        kept = nn.functional.dropout(model.layer.weight, 0.5)
        return {"fit": (kept - 1).square().mean(), **terms(model, generator, stop_at, counter)}

    whole, often = train(fresh(), dropped, SCHEDULE, tmp_path / "whole", {}), replace(SCHEDULE, save_seconds=0.0)
    count = []
    with pytest.raises(KeyboardInterrupt):
        train(fresh(), lambda m, g: dropped(m, g, 25, count), often, tmp_path / "killed", {})
    resumed = train(fresh(), dropped, often, tmp_path / "killed", {})
    assert torch.equal(resumed.layer.weight, whole.layer.weight)


def test_a_state_of_other_settings_or_a_broken_one_is_refused(tmp_path):
    train(fresh(), terms, SCHEDULE, tmp_path, {"settings": {"deep": ["x"]}})
    with pytest.raises(InputError, match=re.escape(f"{tmp_path}/state.pt") + r".* other deep, seed \(0, here 1\);"):
        train(fresh(), terms, replace(SCHEDULE, seed=1), tmp_path, {"settings": {"deep": ["y"]}})
    (tmp_path / "state.pt").write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"state\.pt: "):
        train(fresh(), terms, SCHEDULE, tmp_path, {})


@pytest.mark.slow
def test_max_minutes_ends_the_schedule(tmp_path):
    train(fresh(), terms, replace(SCHEDULE, steps=10**9, max_minutes=0.02), tmp_path, {})
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    assert 1.0 < state["seconds"] < 10
    assert state["optimizer"]["param_groups"][0]["lr"] < 0.05 * SCHEDULE.learning_rate


@pytest.fixture(scope="module")
def models():
    return [generate(LAPTOP, i) for i in range(4)]


@pytest.fixture(scope="module")
def priornet(models, tmp_path_factory) -> PriorNet:
    settings = PriorTraining(schedule=Schedule(steps=60, batch=8), points=256)
    return train_prior(models, LAPTOP, tmp_path_factory.mktemp("prior"), settings)


@pytest.mark.slow
def test_prior_training_sets_the_statistics_of_beta(priornet):
    prior = priornet.prior
    assert torch.linalg.eigvalsh(prior.beta_covariance).min() > 0
    assert prior.beta_mean.abs().max() > 0.1


@pytest.mark.slow
def test_network_training_learns_and_repeats(models, priornet, tmp_path):
    settings = NetTraining(schedule=Schedule(steps=12, batch=8, log_steps=4))
    for name in ("a", "b"):
        train_net(models, LAPTOP, priornet, tmp_path / name, settings)
    first, second = (
        [json.loads(line) for line in (tmp_path / name / "metrics.jsonl").read_text().splitlines()] for name in "ab"
    )
    assert first[-1]["keypoints"] < 0.9 * first[0]["keypoints"]
    # the same up to the order in which a matrix product adds, which depends on where its memory lies
    for a, b in zip(first, second, strict=True):
        assert a["keypoints"] == pytest.approx(b["keypoints"], rel=1e-3)


@pytest.mark.slow
def test_the_refined_answer_is_learned_and_logged(models, priornet, tmp_path):
    schedule = Schedule(steps=2, batch=8, log_steps=1)
    for name, weight in (("with", 6.0), ("without", 0.0)):
        train_net(
            models, LAPTOP, priornet, tmp_path / name, NetTraining(schedule, weights=NetLossWeights(refinement=weight))
        )
    with_it, without = (
        json.loads((tmp_path / name / "metrics.jsonl").read_text().splitlines()[-1]) for name in ("with", "without")
    )
    assert 0 < with_it["refinement"] < 6 * 4 * FAR
    assert "refinement" not in without
    assert with_it["keypoints"] != without["keypoints"]  # the first step already went another way


@pytest.mark.slow
def test_the_hand_is_learned_where_there_are_two(models, priornet, tmp_path):
    for either_hand in (False, True):
        category, folder = replace(LAPTOP, either_hand=either_hand), tmp_path / str(either_hand)
        train_net(models, category, priornet, folder, NetTraining(Schedule(steps=2, batch=4, log_steps=1)))
        terms = json.loads((folder / "metrics.jsonl").read_text().splitlines()[-1])
        assert ("hand" in terms) == either_hand


@pytest.mark.slow
@pytest.mark.parametrize("category", [LAPTOP, EYEGLASSES], ids=lambda category: category.name)
def test_a_network_learns_from_one_with_another_prior(category, models, priornet, tmp_path):
    features = OmadNet(category, PriorNet(category).prior, tells_outside=True)
    settings = NetTraining(schedule=Schedule(steps=1, batch=4, learning_rate=0.0))
    net = train_net(models, LAPTOP, priornet, tmp_path, settings, features=features)
    cloud = torch.randn(2, 512, 3, generator=torch.Generator().manual_seed(0))
    one, other = net.eval()(cloud), features.eval()(cloud)
    torch.testing.assert_close(one.T_input_base, other.T_input_base)
    torch.testing.assert_close(net.prior.basis, priornet.prior.basis)
    assert one.states.shape[1] == len(LAPTOP.joints)


@pytest.mark.slow
def test_fine_tuning_starts_from_given_weights_and_refuses_another_prior(models, priornet, tmp_path):
    settings = NetTraining(schedule=Schedule(steps=1, batch=4, learning_rate=0.0))
    first = train_net(models, LAPTOP, priornet, tmp_path / "a", settings)
    first.own_states = 0.25
    again = train_net(
        models,
        LAPTOP,
        priornet,
        tmp_path / "b",
        replace(settings, schedule=replace(settings.schedule, seed=5)),
        initial=first,
    )
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), again.parameters(), strict=True))
    assert again.own_states == 0.25  # too few objects to hold any back that would tell another
    other = PriorNet(LAPTOP)
    with pytest.raises(InputError):
        train_net(models, LAPTOP, other, tmp_path / "c", settings, initial=first)


def test_the_largest_direction_of_a_basis_has_unit_spread(priornet):
    prior = priornet.prior
    assert float(prior.beta_covariance[0, 0] + prior.beta_mean[0] ** 2) == pytest.approx(1, rel=0.05)
