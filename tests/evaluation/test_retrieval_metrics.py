"""Retrieval's metrics against cases worked by hand and closed forms; galleries are drawn as the tables say."""

import numpy as np
import pytest
import torch

from helpers.categories import DRAWER, EYEGLASSES, LAPTOP
from omad.applications.retrieval.index import Entry, ShapeIndex
from omad.applications.retrieval.signature import Signature, Space, prior_fingerprint
from omad.evaluation.paper.published import TABLE3
from omad.evaluation.retrieval.distances import TOGETHER, Ranker, between, by_information, methods
from omad.evaluation.retrieval.experiment import (
    Draw,
    DrawSettings,
    draw_across_states,
    draw_galleries,
    evaluate_draws,
    openness,
)
from omad.evaluation.retrieval.metrics import average_precision, chance, rank, scores, tier
from omad.evaluation.retrieval.pool import Pool
from omad.model.prior import OmadPrior


def ranked(*answers: str) -> np.ndarray:
    """Relevance of rankings written as strings, '1' a hit."""
    return np.array([[letter == "1" for letter in answer] for answer in answers])


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        ("1110000000000", 1.0),  # all three that there are, first
        ("0000000000111", 0.0),  # beyond the tenth
        ("1010000000000", (1 / 1 + 2 / 3) / 2),
        ("0100100000001", (1 / 2 + 2 / 5) / 3),  # the third relevant one lies beyond the tenth, and counts
        ("111111111111", 1.0),  # more than ten relevant: divided by ten
        ("011111111111", sum((r - 1) / r for r in range(2, 11)) / 10),
        ("000000000000", 0.0),
    ],
)
def test_average_precision_by_hand(answer, expected):
    assert average_precision(ranked(answer))[0] == pytest.approx(expected)


def test_tiers_by_hand():
    answers = ranked("110100", "001110")
    np.testing.assert_allclose(tier(answers, 1), [2 / 3, 1 / 3])
    np.testing.assert_allclose(tier(answers, 2), [1, 1])
    np.testing.assert_allclose(tier(ranked("100001"), 2), [1 / 2])
    found = scores(answers)
    assert (found.nearest_neighbour, found.first_tier, found.second_tier) == (0.5, 0.5, 1.0)
    assert found.map_at_10 == pytest.approx(np.mean([(1 + 1 + 3 / 4) / 3, (1 / 3 + 2 / 4 + 3 / 5) / 3]))


def test_a_perfect_ranking_is_one_everywhere():
    found = scores(ranked("1" * 20 + "0" * 30))
    assert set(vars(found).values()) == {1.0}


def test_a_query_that_is_alone_in_its_gallery_finds_nothing():
    assert set(vars(scores(np.zeros((2, 0), bool))).values()) == {0.0}


def test_short_galleries():
    assert scores(ranked("10", "01")).map_at_10 == pytest.approx(0.75)


@pytest.mark.parametrize("objects", [3, 4, 5, 6])
def test_chance_is_its_closed_form(objects):
    """100 views an object, the query left out: hits at rank r have probability R / G, and precision there is
    (1 + (r - 1)(R - 1) / (G - 1)) / r on average."""
    relevant, gallery = 99, 100 * objects - 1
    row = np.arange(gallery) < relevant
    found = chance(np.tile(row, (400, 1)), np.random.default_rng(0), permutations=5)
    ranks = np.arange(1, 11)
    hit = relevant / gallery
    expected = (hit * (1 + (ranks - 1) * (relevant - 1) / (gallery - 1)) / ranks).sum() / 10
    assert found.map_at_10 == pytest.approx(expected, abs=0.012)
    assert found.nearest_neighbour == pytest.approx(hit, abs=0.04)
    assert found.first_tier == pytest.approx(hit, abs=0.01)
    assert found.second_tier == pytest.approx(2 * hit, abs=0.01)


def test_ranking_leaves_the_query_out_and_puts_what_is_missing_last():
    distances = np.array([[0.0, 3, np.nan, 1], [2, 0, 1, np.nan]])
    np.testing.assert_array_equal(rank(distances), [[0, 3, 1, 2], [1, 2, 0, 3]])
    itself = np.eye(2, 4, dtype=bool)
    np.testing.assert_array_equal(rank(distances, itself), [[3, 1, 2], [2, 0, 3]])
    itself[0, 1] = True  # one query leaves out more than the other: it stands last, behind what is missing
    np.testing.assert_array_equal(rank(distances, itself), [[3, 2, 0], [2, 0, 3]])
    assert rank(np.full((1, 3), np.nan)).shape == (1, 3)


def test_galleries_hold_all_views_of_their_objects_and_the_queries():
    objects = np.repeat([f"o{i}" for i in range(8)], 10)
    draws = draw_galleries(objects, 3, DrawSettings(draws=30, queries=12))
    for draw in draws:
        assert len(draw.gallery) == 30
        assert len(np.unique(objects[draw.gallery])) == 3
        assert len(np.unique(draw.queries[:, 0])) == 12
        assert np.isin(draw.queries, draw.gallery).all()
        assert (objects[draw.queries] == objects[draw.queries[:, :1]]).all()
        assert all(len(set(views)) == TOGETHER for views in draw.queries)
    assert len({name for draw in draws for name in objects[draw.gallery]}) == 8
    again = draw_galleries(objects, 3, DrawSettings(draws=30, queries=12))
    assert all((a.queries == b.queries).all() for a, b in zip(draws, again, strict=True))
    everything = draw_galleries(objects, 100, DrawSettings(draws=1, queries=1000))[0]
    assert len(everything.gallery) == len(everything.queries) == 80


def test_across_states_no_query_is_like_the_gallery():
    objects = np.repeat(["a", "b", "c"], 9)
    opened = np.tile(np.linspace(0, 1, 9), 3)
    for draw in draw_across_states(objects, opened, 2, DrawSettings(draws=5)):
        assert opened[draw.gallery].max() < 0.3
        assert opened[draw.queries].min() > 0.7
        assert set(objects[draw.queries].ravel()) == set(objects[draw.gallery])
        assert len(draw.gallery) == 6


def test_openness_goes_with_every_joint_whatever_its_sign():
    folded = np.radians([[90, -90], [0, 0], [45, -90]])
    np.testing.assert_allclose(openness(folded, EYEGLASSES), [1, 0, 0.75])
    assert openness(np.radians([[85.0]]), LAPTOP)[0] == pytest.approx(1)
    far = [joint.limits[1] * DRAWER.metres_per_unit for joint in DRAWER.joints]
    assert openness(np.array([far]), DRAWER)[0] == pytest.approx(1)


def test_scores_of_views_that_tell_their_objects_and_of_views_that_do_not():
    rng = np.random.default_rng(0)
    objects = np.repeat([f"o{i}" for i in range(10)], 20)
    centre = np.repeat(rng.standard_normal((10, 6)), 20, axis=0)
    draws = draw_galleries(objects, 5, DrawSettings(draws=5, queries=30))
    clear = evaluate_draws(draws, objects, Ranker(between(centre + 1e-3 * rng.standard_normal(centre.shape))))
    assert clear["map_at_10"] == clear["first_tier"] == 1
    assert (clear["objects"], clear["gallery"], clear["draws"]) == (5, 100, 5)
    blind = evaluate_draws(draws, objects, Ranker(between(rng.standard_normal(centre.shape))))
    assert blind["map_at_10"] == pytest.approx(blind["chance"]["map_at_10"], abs=0.05)
    lost = centre.copy()
    lost[:] = np.nan
    assert evaluate_draws(draws, objects, Ranker(between(lost)))["second_tier"] < 0.9


def test_queries_without_an_answer_in_the_gallery_do_not_count():
    """Of methods that take three views of an object that has no more, none is left to find."""
    objects, rng = np.repeat(["a", "b"], [1, 4]), np.random.default_rng(0)
    centre = np.repeat(rng.standard_normal((2, 6)), [1, 4], axis=0)
    draws = draw_galleries(objects, 2, DrawSettings(draws=3, queries=5))
    assert evaluate_draws(draws, objects, Ranker(between(centre)))["map_at_10"] == 1
    few = draw_galleries(objects[:2], 2, DrawSettings(draws=3, queries=2))
    found = evaluate_draws(few, objects[:2], Ranker(between(centre[:2])))
    told = [found[key] for key in ("map_at_10", "nearest_neighbour", "first_tier", "second_tier", "map_at_10_std")]
    assert np.isnan([*told, found["chance"]["map_at_10"]]).all()


def test_information_counts_only_what_is_known():
    betas = np.array([[0.0, 0.0], [0.0, 100.0], [1.0, 0.0]])
    covariances = np.tile(np.diag([1e-2, 1e6]), (3, 1, 1))
    distance = by_information(betas, covariances)(np.array([[0]]), np.array([1, 2]))
    np.testing.assert_allclose(distance, [[100 / np.sqrt(2e6), 1 / np.sqrt(2e-2)]])
    covariances[0] = np.nan
    assert np.isnan(by_information(betas, covariances)(np.array([[0]]), np.array([1, 2]))).all()


def pool_of(objects: int, views: int, rng: np.random.Generator) -> Pool:
    """Views whose errors are what their covariances say, large in another direction on each."""
    size = LAPTOP.basis_size
    truth = np.repeat(rng.standard_normal((objects, size)), views, axis=0)
    spread = np.exp(rng.normal(-1, 1, truth.shape))
    beta = truth + spread * rng.standard_normal(truth.shape)
    covariance = np.square(spread)[:, :, None] * np.eye(size)
    names = np.repeat([f"object {i}" for i in range(objects)], views)
    return Pool(names, np.zeros((len(names), 1)), beta, beta, covariance)


def test_several_views_tell_more_than_one():
    rng = np.random.default_rng(0)
    pool = pool_of(12, 15, rng)
    pool.beta[0], pool.covariance[0] = np.nan, np.nan  # a view on which nothing was seen
    prior = OmadPrior(LAPTOP, generator=torch.Generator().manual_seed(0))
    found = methods(pool, pool.beta, prior, LAPTOP)
    draws = draw_galleries(pool.objects, 12, DrawSettings(draws=3, queries=180))
    reached = {name: evaluate_draws(draws, pool.objects, method)["map_at_10"] for name, method in found.items()}
    assert reached["omad_three_views"] > reached["omad_keypoints"] + 0.02
    assert reached["siamese_three_views"] > reached["siamese"] + 0.02
    assert reached["omad_information"] > reached["omad"]


def test_the_table_ranks_as_the_index_does():
    rng = np.random.default_rng(1)
    pool = pool_of(6, 4, rng)
    prior = OmadPrior(LAPTOP, generator=torch.Generator().manual_seed(0))
    made = prior_fingerprint(prior, LAPTOP)
    signatures = [Signature(made, b, c) for b, c in zip(pool.beta, pool.covariance, strict=True)]
    index = ShapeIndex(Space.of(prior, LAPTOP))
    index.add(signatures, [Entry(str(row)) for row in range(len(signatures))])
    found, every = methods(pool, None, prior, LAPTOP), np.arange(len(signatures))
    for query in (0, 7):
        for name, informed in (("omad_keypoints", False), ("omad_information", True)):
            table = found[name].distance(np.array([[query]]), every)[0]
            hits = index.search(signatures[query], len(index), informed)
            distances = {int(hit.entry.name): hit.distance for hit in hits}
            np.testing.assert_allclose([distances[row] for row in every], table, rtol=1e-4, atol=1e-5)


def test_the_papers_column_is_complete():
    assert all(0 < row.siamese < 1 and 0 < row.omad < 1 and row.objects >= 3 for row in TABLE3.values())


def test_who_says_nothing_has_found_nothing():
    objects = np.array(["a", "a", "b", "b"])
    nothing = Ranker(lambda queries, gallery: np.full((len(queries), len(gallery)), np.nan))
    found = evaluate_draws([Draw(np.arange(4), np.arange(4)[:, None])], objects, nothing)
    assert found["map_at_10"] == found["nearest_neighbour"] == 0
