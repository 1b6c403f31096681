"""Many categories at once: which are fitted, which weights are loaded, and what is said of things of none of them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import logit

import omad
from helpers.chair import chair_view
from omad.applications.solver import Solver
from omad.data.procedural import generate
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import standard_view
from omad.estimation.categories import late
from omad.estimation.categories.late import LateEstimator, shipped_estimators
from omad.estimation.categories.proposals import ENOUGH, MOST, UNASKED, UNKNOWN, Proposals
from omad.estimation.categories.ranking import Ranking, rank
from omad.estimation.estimator import Estimator
from omad.model.checkpoint import shipped_categories
from omad.model.proposals.network import shipped_proposer
from omad.objects.category_file import get_category


@cache
def view(name: str, index: int = 0) -> omad.Observation:
    category = get_category(name)
    return standard_view(generate(category, index, "test"), category, (7, index), ON).observation()


@cache
def estimators() -> list[LateEstimator]:
    return shipped_estimators()


@cache
def laptop() -> Estimator:
    return Estimator.from_pretrained("laptop", "cpu")


# what a look says


def test_few_of_many_are_fitted():
    rng = np.random.default_rng(0)
    names = [f"c{index}" for index in range(24)]
    for sharpness in (1, 5, 30):
        shares = rng.dirichlet(np.full(25, 1 / sharpness))
        look = dict(sorted(zip([*names, None], shares.tolist(), strict=True), key=lambda pair: -pair[1]))
        some = names[:10]
        proposals = Proposals.of(look, some)
        chosen = proposals.worth_fitting(some)
        order = sorted(some, key=lambda name: -look[name])
        assert chosen == order[: len(chosen)]
        assert 1 <= len(chosen) <= MOST
        covered = sum(look[name] for name in chosen) / sum(look[name] for name in some)
        assert covered >= ENOUGH or len(chosen) == MOST
        assert proposals.none == pytest.approx(1 - sum(look[name] for name in some))


def test_what_the_look_does_not_know_is_always_fitted():
    proposals = Proposals.of({"a": 0.9, "b": 0.08, None: 0.02}, ["a", "b", "own"])
    assert proposals.worth_fitting(["a", "b", "own"]) == ["a", "b", "own"]
    assert proposals.worth_fitting(["own"]) == ["own"]
    assert proposals.doubt("own") == pytest.approx(np.log(0.02 / UNKNOWN))
    assert Proposals.of({"a": 0.9, None: 0.1}, ["a"]).doubt("a") == pytest.approx(-logit(0.9))
    assert Proposals.of({"a": 0.9, None: 0.1}, ["own"]).none == pytest.approx(1)


def test_who_names_categories_is_believed_more_than_the_look():
    look = {"drawer_4": 0.6, "drawer": 0.3, "jar": 0.05, None: 0.05}
    of_all, of_one = (Proposals.of(look, names) for names in (["drawer", "drawer_4"], ["drawer"]))
    assert of_all.shares == pytest.approx({"drawer_4": 0.6, "drawer": 0.3})
    assert of_all.none == pytest.approx(0.1)  # jars have no weights: nobody could have named them
    assert of_one.doubt("drawer") == pytest.approx(np.log((0.1 + UNASKED * 0.6) / 0.3))
    assert sum(of_one.shares.values()) + of_one.none == pytest.approx(1)


# an answer


def test_the_shipped_look_proposes_the_true_category():
    names, propose = shipped_categories(), shipped_proposer()
    there = []
    for name in names:
        for found in propose([view(name, index) for index in range(6)]):
            there.append(name in Proposals.of(found, names).worth_fitting(names))
    assert np.mean(there) >= 0.98


def test_the_look_is_that_of_a_level_camera_where_gravity_is_known():
    category, roll = get_category("laptop"), np.diag([-1.0, -1.0, 1.0])
    seen = standard_view(generate(category, 1, "test"), category, (7, 1), ON)
    upside_down = omad.Observation.from_points(seen.observation().points @ roll)
    ranking = rank(upside_down, estimators(), omad.Known(gravity=-roll @ seen.T_camera_base[:3, 1]))
    assert ranking.candidates[0].estimate.category.name == "laptop"
    assert ranking.candidates[0].probability > 0.9


def test_only_proposed_categories_are_loaded(monkeypatch):
    loaded = []
    read = Estimator.from_pretrained

    def noted(folder, device, config):
        loaded.append(folder.name)
        return read(folder, device, config)

    monkeypatch.setattr(late.Estimator, "from_pretrained", noted)
    fresh = shipped_estimators()
    ranking = rank(view("laptop"), fresh)
    assert ranking.candidates[0].estimate.category.name == "laptop"
    assert sorted(loaded) == sorted(one.estimate.category.name for one in ranking.candidates)
    assert len(loaded) <= min(MOST, len(fresh) - 1)
    rank(view("laptop", 1), fresh)
    assert len(loaded) == len(set(loaded))  # what is loaded stays


def test_a_late_estimator_answers_as_the_estimator_does():
    one, seen = LateEstimator.of("laptop"), view("laptop")
    assert one.category == laptop().category
    for name, tensor in laptop().net.prior.state_dict().items():
        assert np.array_equal(one.prior.state_dict()[name], tensor)
    assert "loaded" not in vars(one)
    assert np.array_equal(one(seen).keypoints, laptop()(seen).keypoints)
    assert one([seen, seen])[1].joint_states == pytest.approx(laptop()(seen).joint_states, abs=1e-5)


def test_a_late_estimator_tracks_and_takes_several_views():
    one, seen, poses = LateEstimator.of("laptop"), view("laptop"), [np.eye(4)] * 2
    found, expected = one([seen, seen], T_world_camera=poses), laptop()([seen, seen], T_world_camera=poses)
    assert np.array_equal(found[1].keypoints, expected[1].keypoints)
    trackers = omad.Tracker(one), omad.Tracker(laptop())
    for time, frame in enumerate((seen, seen, None)):
        late_one, own = (tracker(frame, 0.1 * time).estimate for tracker in trackers)
        assert np.array_equal(late_one.keypoints, own.keypoints)
    assert np.array_equal(late_one.to_surface().keypoints, own.keypoints)  # nothing was seen to go to


TWINS = (
    {"drawer", "drawer_1", "drawer_2", "drawer_4", "drawer_5"},
    {"cabinet_one_door", "cabinet_two_doors", "refrigerator", "refrigerator_two_doors"},
)
"""What views of shut ones do not tell apart."""


def near(name: str) -> set[str]:
    """The category and what is hardly another one."""
    return {name}.union(*(twins for twins in TWINS if name in twins))


def test_a_chair_is_none_of_them_and_objects_are_not():
    assert sum(rank(chair_view(seed).observation(), estimators()).is_none for seed in range(5)) >= 4
    right, almost = [], []
    for name in shipped_categories():
        for index in range(2):
            ranking = rank(view(name, index), estimators())
            found = None if ranking.is_none else ranking.candidates[0].estimate.category.name
            right.append(found == name)
            almost.append(found in near(name))
            assert ranking.none + sum(one.probability for one in ranking.candidates) == pytest.approx(1)
    assert np.mean(right) >= 0.85
    assert np.mean(almost) >= 0.94


def test_those_asked_for_are_always_fitted():
    ranking = rank(view("laptop"), estimators(), always=["scissors"])
    assert "scissors" in [one.estimate.category.name for one in ranking.candidates]


def test_a_known_hand_is_that_of_categories_of_either_hand():
    category, own = get_category("safe"), LateEstimator.of("safe")
    shut = standard_view(generate(category, 0, "test"), category, (7, 0), states=np.zeros(1)).observation()
    known, names = omad.Known(mirrored_probability=1.0), ["laptop", "safe"]
    ranking = rank(shut, [own, laptop()], known, always=names)
    hands = {one.estimate.category.name: one.estimate.mirrored_probability for one in ranking.candidates}
    assert hands == {"laptop": None, "safe": 1.0}
    for estimator in (own, laptop()):
        assert Solver(None, lambda one=estimator: [one], known)(shut, None).estimate.category == estimator.category


@pytest.mark.parametrize("always", ["laptop", ["lapdog"], [""]])
def test_what_is_to_be_fitted_always_are_names_of_the_estimators(always):
    with pytest.raises(omad.InputError, match=r"always: is .*; give a list of the estimators' categories: laptop"):
        rank(view("laptop"), [laptop()], always=always)


def test_a_category_without_an_answer_is_not_ranked():
    observation = view("laptop")
    other = Estimator.from_pretrained("dishwasher", "cpu")
    estimate = other(observation)
    nothing = np.full_like(estimate.keypoints, np.nan)
    lost = replace(estimate, keypoints=nothing, canonical_keypoints=nothing, beta=np.full_like(estimate.beta, np.nan))

    class Lost:
        net, category = other.net, other.category

        def first_answers(self, *_):
            return [lost]

    ranking = rank(observation, [Lost(), laptop()], always=["dishwasher"])
    assert [candidate.estimate.category.name for candidate in ranking.candidates] == ["laptop"]
    assert rank(observation, [Lost()]) == Ranking((), 1.0)
    assert rank(observation, [Lost()]).is_none
