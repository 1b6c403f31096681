"""Categories are told apart by the object's front, and by nothing else; what fronts do not tell stays as it was."""

from typing import Any

import numpy as np
import pytest
from scipy.special import softmax

from omad.data.procedural import generate
from omad.data.rendering.depth_noise import ON
from omad.data.rendering.standard_views import standard_view
from omad.estimation.categories.fronts import FRONT, front_says, told_apart
from omad.estimation.estimate import Estimate
from omad.estimation.estimator import Estimator
from omad.model.fronts.network import shipped_front_net
from omad.objects.category_file import get_category
from omad.sensing.observation import Observation


class Says:
    """In place of the network."""

    names = ("drawer", "drawer_4", "oven")

    def __init__(self, *shares: float) -> None:
        self.shares = shares

    def says(self, images: np.ndarray) -> np.ndarray:
        return np.log([self.shares] * len(images))


@pytest.fixture(scope="module")
def view() -> Observation:
    category = get_category("drawer")
    return standard_view(generate(category, 0, "test"), category, (5, 0), ON).observation()


@pytest.fixture(scope="module")
def answers(view: Observation) -> list[Estimate]:
    return [Estimator.from_pretrained(name, "cpu")(view) for name in ("drawer_4", "drawer", "safe")]


def test_the_front_counts_among_those_that_it_tells(answers: list[Estimate]):
    scores = np.log([0.5, 0.3, 0.1])
    net: Any = Says(0.6, 0.2, 0.2)
    told = told_apart(answers, scores, net)
    assert scores.tolist() == np.log([0.5, 0.3, 0.1]).tolist()  # not changed in place
    before, after = softmax([*scores, 0.0]), softmax([*told, 0.0])
    assert after[2:] == pytest.approx(before[2:])  # of a category that it does not know, and of none
    assert after[:2].sum() == pytest.approx(before[:2].sum())
    assert after[1] / after[0] == pytest.approx(0.3 / 0.5 * (0.6 / 0.2) ** FRONT)


def test_it_tells_nothing_of_one_alone(answers: list[Estimate]):
    net: Any = Says(0.6, 0.2, 0.2)
    assert told_apart(answers[1:], np.array([0.3, 0.1]), net).tolist() == [0.3, 0.1]
    without = np.array([-np.inf, 0.3, 0.1])
    assert told_apart(answers, without, net).tolist() == without.tolist()
    assert told_apart([], np.zeros(0), net).tolist() == []


def test_where_nothing_is_seen_of_it_it_says_nothing(answers: list[Estimate]):
    net: Any = Says(0.6, 0.2, 0.2)
    unseen = [answer.without_labels() for answer in answers[:2]]
    assert front_says(unseen, np.zeros(2), net).tolist() == [0.0, 0.0]


def test_drawers_are_counted_where_an_answer_for_another_number_has_the_chest():
    three, five = Estimator.from_pretrained("drawer", "cpu"), Estimator.from_pretrained("drawer_5", "cpu")
    right = []
    for own, other in ((three, five), (five, three)):
        category = own.category
        for index in range(6):
            seen = standard_view(generate(category, index, "test"), category, (5, index), ON).observation()
            said = front_says([own(seen), other(seen)], np.array([-20.0, 0.0]), shipped_front_net())
            right.append(said[0] > said[1])
    assert np.mean(right) >= 0.9
