"""Rivals are told apart by their surfaces, and by nothing else; others stay as they were."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.special import softmax

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import standard_view
from omad.estimation.categories import rivals
from omad.estimation.categories.rivals import MOST, NEARER, RIVAL, nearness, rivals_of, told_apart
from omad.estimation.estimator import Estimator
from omad.objects.category_file import get_category

VIEW: Any = None
"""Nobody looks at it."""


@dataclass
class Answer:
    """As much of an estimate as is asked for here."""

    near: float
    surfaces: object = "some"


def apart(monkeypatch, answers: list[Any], probability: list[float]) -> np.ndarray:
    """(C + 1,) probabilities once rivals were told apart, of none last; there are as many as of the others together."""
    monkeypatch.setattr(rivals, "nearness", lambda _, answer: answer.near)
    scores = np.log(probability) + 2.0
    before = scores.copy()
    told = told_apart(VIEW, answers, scores)
    assert np.array_equal(scores, before)  # not changed in place
    return softmax([*told, 2.0])


def test_the_nearer_of_two_rivals_counts_more_and_no_other(monkeypatch):
    answers = [Answer(0.5), Answer(0.6), Answer(0.99)]
    before = softmax([*(np.log([0.5, 0.4, 0.02]) + 2.0), 2.0])
    after = apart(monkeypatch, answers, [0.5, 0.4, 0.02])
    assert after[2:] == pytest.approx(before[2:])
    assert after[:2].sum() == pytest.approx(before[:2].sum())
    assert after[1] / after[0] == pytest.approx(0.4 / 0.5 * np.exp(0.1 * NEARER))


def test_who_has_no_rival_or_no_surface_stays_as_he_was(monkeypatch):
    sure = [0.5, 0.9 * RIVAL * 0.5]
    assert apart(monkeypatch, [Answer(0.0), Answer(1.0)], sure) == pytest.approx(softmax([*(np.log(sure) + 2), 2.0]))
    close = [0.5, 0.4]
    hulls = [Answer(0.0), Answer(1.0, surfaces=None)]
    assert apart(monkeypatch, hulls, close) == pytest.approx(softmax([*(np.log(close) + 2), 2.0]))


def test_rivals_are_few_and_likeliest_first():
    answers: list[Any] = [Answer(0.0)] * 6
    scores = np.log([0.1, 0.3, 0.2, 0.25, 0.01, 0.14])
    assert rivals_of(answers, scores) == [1, 3, 2][:MOST]
    assert rivals_of(answers[:2], np.array([-np.inf, 0.0])) == [1]
    assert rivals_of(answers[:2], np.array([-np.inf, -np.inf])) == []


def test_a_chest_is_nearer_to_its_own_kind():
    """In most views the surface with the right number of drawers comes nearer to what was seen."""
    three, five = Estimator.from_pretrained("drawer", "cpu"), Estimator.from_pretrained("drawer_5", "cpu")
    lead = []
    for own, other in ((three, five), (five, three)):
        category = get_category(own.category.name)
        for index in range(6):
            view = standard_view(generate(category, index, "test"), category, (5, index), ON).observation()
            lead.append(nearness(view, own(view)) - nearness(view, other(view)))
    assert np.mean(np.array(lead) > 0) >= 0.75
