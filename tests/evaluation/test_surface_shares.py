"""How far to go towards surfaces: the share with the least error, where that is no chance."""

import numpy as np
import pytest

import omad
from omad.data.procedural import generate
from omad.evaluation.confidence import surface_shares
from omad.evaluation.confidence.surface_shares import TRIED, best_shares, follows_better, measured_shares


def errors_of(keypoints: np.ndarray, fits: np.ndarray) -> np.ndarray:
    """(N, T) of answers so far between signed errors (N,) of both."""
    return np.abs(keypoints[:, None] + TRIED * (fits - keypoints)[:, None])


def test_the_best_share_is_taken_where_it_is_surely_better():
    rng = np.random.default_rng(0)
    a, b, worse = rng.normal(0, 1, 400), rng.normal(0, 1, 400), rng.normal(0, 5, 400)
    found = best_shares(np.stack([errors_of(a, b), errors_of(a, worse), errors_of(b, 0.05 * b)], 2))
    assert found.taken.tolist() == [0.5, 0.0, 1.0]  # of two that err alike the middle; none; all
    assert found.errors[0] == pytest.approx([np.abs(a).mean(), np.abs(a).mean(), np.abs(b).mean()])
    assert found.errors[1] == pytest.approx([np.abs(b).mean(), np.abs(worse).mean(), 0.05 * np.abs(b).mean()])
    assert found.errors[2][0] == pytest.approx(np.abs(a + b).mean() / 2)
    assert found.shrinkage[1] == 1
    assert found.views == 400


def test_one_view_does_not_outweigh_the_others():
    rng = np.random.default_rng(2)
    a = rng.normal(0, 1, 60)
    wild = np.where(np.arange(60) < 2, 30.0, a)
    found = best_shares(errors_of(wild, np.where(np.arange(60) < 2, 0.0, 1.5 * a))[..., None])
    assert found.taken.tolist() == [0.0]  # two views gain a lot, all others lose


def test_what_may_be_chance_is_left():
    rng = np.random.default_rng(1)
    a = rng.normal(0, 1, 12)
    found = best_shares(errors_of(a, a + rng.normal(0, 0.5, 12) - 0.01 * np.sign(a))[..., None])
    assert found.taken.tolist() == [0.0]
    assert found.errors[2].tolist() == found.errors[0].tolist()


@pytest.mark.slow
def test_shares_are_measured_on_clean_and_spoilt_views(monkeypatch):
    estimator = omad.Estimator.from_pretrained("laptop", "cpu")
    models = [generate(estimator.category, index, "train", 1) for index in range(3)]
    assert measured_shares(estimator, models, 2, seed=0) is None
    monkeypatch.setattr(surface_shares, "FEWEST", 2)
    found = measured_shares(estimator, models, 6, seed=0)
    assert found is not None
    assert 2 <= found.views <= 6
    assert set(found.taken) <= set(TRIED)
    assert (found.errors[2] <= found.errors[0]).all()
    again = measured_shares(estimator, models, 6, seed=0)
    assert again is not None
    assert np.allclose(again.errors, found.errors)


def follows(name: str, views: int) -> bool:
    estimator = omad.Estimator.from_pretrained(name, "cpu")
    models = [generate(estimator.category, index, "train", 1) for index in range(12)]
    return follows_better(estimator, estimator.surfaces.bank, models, views, seed=0)


@pytest.mark.slow
def test_surfaces_follow_what_is_seen_where_that_is_nearer(monkeypatch):
    monkeypatch.setattr(surface_shares, "FEWEST", 9)
    assert follows("scissors", 9)
    assert not follows("laptop", 12)
    monkeypatch.setattr(surface_shares, "_surely", lambda gains: gains[0] * 0 + 1)
    assert not follows("scissors", 2)  # too few to say
    monkeypatch.setattr(surface_shares, "FEWEST", 2)
    assert follows("scissors", 2)
