"""Held-back objects: kept apart, watched, and what they say of how far to trust the fit."""

import json
from dataclasses import dataclass, replace
from itertools import pairwise

import pytest
import torch

from helpers.categories import DRAWER, LAPTOP
from helpers.scenes import scene
from omad.data.procedural import generate
from omad.data.training_views import ViewSettings
from omad.estimation.estimator import Estimator
from omad.model.checkpoint import find_weights, load, save
from omad.model.fitting.energy import RefinementConfig
from omad.model.fitting.leaning import leaning
from omad.model.fitting.refinement import Refiner, free_directions
from omad.model.omadnet import OmadNet
from omad.model.priornet import PriorNet
from omad.sensing.observation import Observation
from omad.training.held_back import HeldBack, split
from omad.training.loop import Schedule, train
from omad.training.train_prior import PriorTraining, train_prior


@dataclass(frozen=True)
class Model:
    """One, or a variant of ``own``."""

    name: str

    @property
    def own(self) -> str:
        return self.name.partition("-")[0]


def test_few_objects_are_all_trained_on_and_many_give_a_few():
    for count, held in ((3, 0), (19, 0), (20, 1), (300, 15), (1000, 16)):
        models = [Model(f"object {index}") for index in range(count)]
        seen, kept = split(models)
        assert len(kept) == held
        assert {*seen} | {*kept} == {*models}
        assert not {*seen} & {*kept}


def test_of_more_objects_none_is_held_back_that_fewer_of_them_were_trained_on():
    models = [Model(f"laptop-train-{index}") for index in range(4000)]
    counts = (20, 300, 1000, 2500, 4000)
    for fewer, more in pairwise(counts):
        seen, _ = split(models[:fewer])
        _, kept = split(models[:more])
        assert not {*seen} & {*kept}


def test_of_variants_that_take_turns_no_model_is_held_back_whole():
    for own in range(2, 61):
        seen, kept = split([Model(f"{index % own}-{index}") for index in range(300)])
        assert {model.own for model in seen} == {*map(str, range(own))}
        assert len({model.own for model in kept}) > min(own, len(kept)) / 3


@pytest.fixture(scope="module")
def held_back() -> HeldBack:
    return HeldBack.of([generate(LAPTOP, index) for index in range(4)], LAPTOP, ViewSettings(), "cpu")


@pytest.fixture
def net() -> OmadNet:
    return load(OmadNet, find_weights("laptop"))


def test_a_fit_that_is_better_than_the_network_is_trusted(held_back, net):
    errors = held_back.errors(net)
    assert errors["held back, refined (degrees)"] < errors["held back, own (degrees)"]
    assert held_back.best_share(net) < 0.5


def test_a_fit_that_is_worse_is_not(held_back, net):
    """A prior that puts hinges where they are not: the answer is then the network's."""
    with torch.no_grad():
        net.prior.joint_out.bias[4:6] += 0.4
    errors = held_back.errors(net)
    assert errors["held back, refined (degrees)"] > 2 * errors["held back, own (degrees)"]
    assert held_back.best_share(net) == 1.0


def test_the_estimator_reads_what_the_weights_say(held_back, net, tmp_path):
    net.own_states = 1.0
    save(net, tmp_path, {})
    told, fitted = (Estimator(load(OmadNet, folder)) for folder in (tmp_path, find_weights("laptop")))
    assert told.net.own_states == 1.0
    cloud = held_back.views.points[0].double().numpy() * LAPTOP.metres_per_unit
    one, other = told(Observation(cloud)), fitted(Observation(cloud))
    assert one.joint_states != pytest.approx(other.joint_states, abs=1e-6)
    assert one.initial.joint_states == pytest.approx(other.initial.joint_states, abs=1e-6)


def test_other_unknowns_follow_the_states_as_the_fit_would_have_them():
    """For small changes as a fit with the states held there."""
    s = scene(DRAWER, batch=4)
    config = RefinementConfig(huber=None, step_tolerance=1e-12, cost_tolerance=0.0)
    refined = Refiner(s.prior, s.limits, config)(s.targets, s.truth)
    wanted = refined.state.joint_states + 1e-3 * torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    found = leaning(refined, wanted, 1.0, s.prior, s.targets)
    torch.testing.assert_close(found.state.joint_states, wanted)
    held = Refiner(s.prior, s.limits, config, free_directions(3, s.prior.basis_size, hold_states=True))
    exact = held(s.targets, replace(refined.state, joint_states=wanted))
    moved = (exact.state.pack() - refined.state.pack()).abs().max()
    assert (found.state.pack() - exact.state.pack()).abs().max() < 0.02 * moved
    half = leaning(refined, wanted, 0.5, s.prior, s.targets).state.joint_states
    torch.testing.assert_close(half, (wanted + refined.state.joint_states) / 2)


def test_broken_fits_lean_alone():
    s = scene(LAPTOP, batch=2)
    refined = Refiner(s.prior, s.limits)(s.targets, s.truth)
    broken = replace(refined, covariance=torch.full_like(refined.covariance, torch.nan))
    found = leaning(broken, s.truth.joint_states + 1, 1.0, s.prior, s.targets)
    torch.testing.assert_close(found.state.joint_states, s.truth.joint_states + 1)
    torch.testing.assert_close(found.state.beta, refined.state.beta)


def test_progress_tells_held_back_errors_and_the_time_left(tmp_path, capsys):
    model = torch.nn.Linear(1, 1)
    schedule = Schedule(steps=100, batch=1, log_steps=1)
    train(model, lambda m, g: {"fit": m.weight.sum() ** 2}, schedule, tmp_path, {}, lambda m: {"held back": 0.25})
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows if "held back" in row] == list(range(5, 101, 5))
    told = capsys.readouterr().err
    assert "0 min left" in told
    assert "held back 0.2500" in told


def test_priors_are_watched(tmp_path):
    models = [generate(LAPTOP, index) for index in range(20)]
    train_prior(models, LAPTOP, tmp_path, PriorTraining(Schedule(steps=2, batch=2, log_steps=1), points=64))
    row = json.loads((tmp_path / "metrics.jsonl").read_text().splitlines()[-1])
    assert row["held back, keypoints"] > 0
    assert row["held back, pivots"] > 0


def test_a_prior_to_fine_tune_begins_with_betas_of_its_own_basis(tmp_path):
    initial = load(PriorNet, find_weights("laptop") / "prior")
    settings = PriorTraining(Schedule(steps=1, batch=16, log_steps=1))
    train_prior([generate(LAPTOP, index) for index in range(8)], LAPTOP, tmp_path, settings, initial=initial)
    assert json.loads((tmp_path / "metrics.jsonl").read_text())["order"] < 0.15


def test_a_gain_that_may_be_chance_is_none(held_back, net, monkeypatch):
    truth = held_back.views.states
    noise = torch.randn(truth.shape, generator=torch.Generator().manual_seed(0))
    noise -= noise.mean()

    def states(answers, net, share):
        return truth + 1 + share * (0.5 * noise - 0.02)  # better in the mean, by a third of a standard error

    monkeypatch.setattr("omad.training.held_back._states", states)
    assert held_back.best_share(net) == 0.0
